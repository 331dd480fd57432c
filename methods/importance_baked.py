"""BSDF importance baking with the exact density of the learned map, so without bias."""

from __future__ import annotations

import copy
import math
from typing import ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Knob
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.importance_maps.baked_method import BakedMethod
from harness.importance_maps.database import Maps
from harness.importance_maps.training import MapBatches
from harness.nets import defensive, spline
from harness.nets.coupling import CouplingNet
from harness.nets.encoding import ConditionEncoder
from harness.nets.extremes import FAR, held
from harness.nets.spline_couplings import SplineCouplings, chord

SUPERVISIONS = ("both", "likelihood", "map")
_AREA = 4.0
"""Of the square [-1, 1]^2 that uniforms are scaled to."""


class MonotoneMap(nn.Module):
    """The networks of both splines; last layers start at zero, so both begin as identities."""

    def __init__(self, material: Material, width: int, layers: int, bins: int, frequencies: int):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        encoded, numbers = self.encoder.width, spline.outputs(bins)
        self.x_given_b = CouplingNet(encoded, width, numbers, frequencies, layers)
        self.y_given_x = CouplingNet(encoded, width, numbers, frequencies, layers)
        # Of (y, x), to (b, a).
        self.map = SplineCouplings([self.y_given_x, self.x_given_b], bins, square=True)


class ImportanceBaked(BakedMethod):
    r"""A network compresses optimal-transport maps: Bai et al. (2023), made exact.

    The paper bakes for each slice the transport map T from the unit square to the disk, lets a
    network predict T's direction and, beside it, the weight f / p, which makes it biased by
    what either gets wrong (``importance-baked-published``). Here the same maps are learned by
    a network that is invertible by construction, and the weight is f over its exact density.

    **Why two splines are enough.** The optimal map is the gradient of a convex function, so its
    Jacobian is symmetric and positive definite. With uniforms (a, b) scaled to [-1, 1] and
    T = (x, y), x therefore rises with a where b is held; and y rises with b where *x* is held,
    for the slope there is :math:`\det J / \partial_a x > 0`. So T is exactly

    .. math:: x = F^{-1}(a \mid b), \qquad y = \sqrt{1 - x^2}\; G^{-1}(b \mid x)

    with increasing F and G: two rational-quadratic splines (:mod:`harness.nets.spline`), given
    by networks of the encoded condition and of b or x. Nothing folds, every direction of the
    open disk has one preimage, all samples lie on the disk, and

    .. math:: p(\omega) = \frac{1}{4}\,F'(x \mid b)\,\frac{G'(y / \sqrt{1 - x^2} \mid x)}
                          {\sqrt{1 - x^2}}, \quad b = G(y / \sqrt{1 - x^2} \mid x).

    Row-column maps have this form too (F without b), so ``kind`` may be ``row-column``;
    ``hierarchical`` ones, which jump, are only approximated.

    ``supervision``: ``map`` regresses the uniforms of the baked cells, in absolute error (the
    paper's loss, but on the uniforms and not the directions: in units of probability a narrow
    lobe counts as much as a broad one); ``likelihood`` maximises that of the baked
    directions, forgetting where they came from, as a flow does; ``both`` does the first with a
    weight that falls to zero over the fit.

    ``slices`` maps of ``resolution``^2 cells are baked for a fit (no more than the budget's
    ``pool``), or read from ``database``, a folder that ``harness bake`` made. A share
    ``uniform`` of the samples is uniform on the disk (:mod:`harness.nets.defensive`).

    Uses three uniforms. One network runs again at the rounded sample, so that its density is
    the one that :meth:`pdf` gives.
    """

    name = "importance-baked"
    uniforms = 3
    learning_rate = 1e-2

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("slices", (256, 512, 1024, 2048), "importance maps baked"),
        Knob("bins", (5, 10, 20), "bins of each spline"),
        Knob("width", (16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers of a spline's network"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        width: int = 32,
        layers: int = 2,
        bins: int = 10,
        frequencies: int = 4,
        slices: int = 1024,
        resolution: int = 32,
        kind: str = "optimal-transport",
        supervision: str = "both",
        uniform: float = 0.01,
        precision: str = "float32",
        database: str = "",
    ):
        if not 2 <= bins < 500:
            raise InputError(f"{self.name}: bins is {bins}; expected 2 to 499")
        if layers < 1 or slices < 1:
            raise InputError(
                f"{self.name}: expected at least one of layers and slices,"
                f" not {layers} and {slices}"
            )
        if supervision not in SUPERVISIONS:
            raise InputError(
                f"{self.name}: supervision is '{supervision}'; expected one of {SUPERVISIONS}"
            )
        self.width, self.layers, self.bins, self.frequencies = width, layers, bins, frequencies
        self.supervision = supervision
        self.bake_with(slices, resolution, kind, database)
        self.uniform = defensive.checked_share(uniform, self.name)
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> MonotoneMap:
        """See :meth:`ModuleMethod.build`."""
        return MonotoneMap(material, self.width, self.layers, self.bins, self.frequencies)

    def meet(self, condition: Tensor) -> None:
        """See :meth:`BakedMethod.meet`."""
        self.module.encoder.standardise(condition)

    def baked_loss(
        self, batches: MapBatches, budget: Budget, generator: torch.Generator, left: float
    ) -> Tensor:
        """See :meth:`BakedMethod.baked_loss`."""
        condition, u, wo, _ = batches.draw(budget.conditions, budget.directions, generator)
        ab, log_slope = self._to_square(self.module, condition, wo)
        likelihood = math.log(_AREA) - log_slope
        if self.supervision == "likelihood":
            return likelihood.mean()
        apart = (ab - (2 * u - 1)).abs().sum(-1)
        if self.supervision == "map":
            return apart.mean()
        return (likelihood + _MAP_WEIGHT * left * apart).mean()

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        _, log_slope = self._to_square(self.module, condition, wo)
        inside = wo[..., 0].abs() < 1
        flow = torch.where(inside, log_slope - math.log(_AREA), -math.inf)
        return defensive.log_mixed(flow, wo, self.uniform)

    def _to_square(self, net: MonotoneMap, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """The point (a, b) of [-1, 1]^2 that becomes ``wo``, and log |d(a, b) / dwo|: [B, D]."""
        encoded = net.encoder(condition)
        x, y = wo.unbind(-1)
        squared = (1 - x) * (1 + x)
        log_chord = 0.5 * torch.where(squared > 0, squared, 1).log()
        b, slope_b = spline.warp(net.y_given_x(x, encoded), y * torch.exp(-log_chord))
        a, slope_a = spline.warp(net.x_given_b(b, encoded), x)
        # Off the disk there is no preimage.
        outside = (b.abs() >= 1) | (squared <= 0)
        slope = torch.where(outside, -math.inf, slope_a + slope_b - log_chord)
        return torch.stack([a, b], -1), slope

    def notes(self, maps: Maps) -> str:
        """See :meth:`BakedMethod.notes`."""
        said = super().notes(maps)
        return f"{said}, {maps.black} black conditions left out" if maps.black else said

    @torch.no_grad()
    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.inverse`: the uniforms [N, 3] of the map's branch, in double."""
        net = copy.deepcopy(self.module).double()
        ab, _ = self._to_square(net, condition.double(), wo[:, None].double())
        u = (ab[:, 0] + 1) / 2
        # The middle of what is not the uniform share's.
        return torch.cat([u, torch.full_like(u[:, :1], (1 + self.uniform) / 2)], 1)

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: all probability in the first bin of either spline."""
        found = self.state_dict()
        for net in ("x_given_b", "y_given_x"):
            found = held(found, f"{net}.mlp.layers.{self.layers}", slice(0, 1), FAR)
        return {"first-bins-widest": found}

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        net = self.module
        encoded = net.encoder.encoded(c)
        a, b = (dr.fma(2, v, -1) for v in u[:2])
        elsewhere = u[2] < self.uniform
        there = defensive.uniform_disk_columns(u)
        (y, x), back = net.map.draw_columns([b, a], encoded, elsewhere, there[::-1])
        return x, y, self._density(back, x, y)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        encoded = self.module.encoder.encoded(c)
        x, y = wo
        return self._density(self.module.map.to_base_columns([y, x], encoded), x, y)

    def _density(self, back: tuple[Float, Float, Float], x: Float, y: Float) -> Float:
        """Density at ``(x, y)``; ``back`` is its (b, a), and the map's determinant."""
        b, _, slope = back
        at = y / chord(x, square=True)
        inside = (dr.abs(x) < 1) & (dr.abs(at) < 1)
        # A nan compares with nothing, and has to come out as one.
        there = inside | dr.isnan(x) | dr.isnan(y) | dr.isnan(b)
        pdf = dr.select(there, slope / _AREA, 0)
        return defensive.mixed_columns(pdf, [x, y], self.uniform)


_MAP_WEIGHT = 1.0
"""Nats per unit of the uniforms: at the start an error of the map counts as much as likelihood."""
