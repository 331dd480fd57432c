"""The normalizing flow of NeuSample: two spline couplings over a conditional Gaussian."""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Knob
from harness.fitting.flow_method import FlowMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.nets import defensive, lobes, spline
from harness.nets.coupling import CouplingNet, unit_normal_columns
from harness.nets.encoding import ConditionEncoder, Encoded
from harness.nets.extremes import FAR, held
from harness.nets.mlp import MLP
from harness.nets.spline_couplings import SplineCouplings

_START = -0.7
"""Log sigma of the base before fitting: half the disk's radius, broad but mostly inside."""
FORMS = {"domain": ("disk", "square"), "lambertian": (False, True), "uniform": (0.01, 0.03)}


class SplineFlow(nn.Module):
    """The networks: condition -> base Gaussian; other coordinate and condition -> spline.

    Coupling i warps x given y where i is even, y given x where it is odd. Last layers start
    at zero: every condition starts with identity splines over one broad Gaussian.
    """

    def __init__(
        self,
        material: Material,
        width: int,
        layers: int,
        bins: int,
        couplings: int,
        frequencies: int,
        lambertian: bool = False,
        square: bool = False,
    ):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        encoded = self.encoder.width
        self.base = MLP([encoded, width, 5 if lambertian else 4], "leaky_relu", zero_last=True)
        with torch.no_grad():
            self.base.layers[-1].bias[2:4] = _START
        self.couplings = nn.ModuleList(
            CouplingNet(encoded, width, spline.outputs(bins), frequencies, layers)
            for _ in range(couplings)
        )
        self.map = SplineCouplings(self.couplings, bins, square)

    @property
    def x_given_y(self) -> CouplingNet:
        """The first coupling."""
        return self.couplings[0]

    @property
    def y_given_x(self) -> CouplingNet:
        """The second."""
        return self.couplings[1]


class NeuralSplineFlow(FlowMethod):
    r"""Two rational-quadratic spline couplings: eqs. 3-4 of Xu et al. (2023), NeuSample.

    .. math:: x' = f(x \mid y), \quad y' = g(y \mid x'), \qquad
              p(\omega) = \mathcal{N}(x', y';\,\mu, \sigma)\,
              \frac{\partial f}{\partial x}\,\frac{\partial g}{\partial y}

    f and g are rational-quadratic splines (Durkan et al. 2019) of K = 20 bins on [-1, 1] with the
    identity beyond (:mod:`harness.nets.spline`), their 59 numbers given by networks
    39-32-32-59 of the other coordinate (encoded with four frequencies) and the encoded
    condition. A network 30-32-4 of the condition gives the diagonal Gaussian's mean and log
    sigma. LeakyReLU of slope 0.01 throughout. Two uniforms make the Gaussian's sample,
    which is taken through the inverses: y, then x.

    ``domain="disk"`` is the paper's: the splines act on the projected disk's own
    coordinates. ``domain="square"`` has them act on :math:`(x / \sqrt{1 - y^2},\, y)`, which
    makes the disk a square whose edges the splines need not find; the density is divided by
    the chord :math:`\sqrt{1 - y^2}` (by 1 where |y| >= 1, off the disk). In either, what the
    Gaussian puts beyond [-1, 1] passes as it is and becomes an invalid sample.

    A share ``uniform`` of the samples is uniform on the disk (:mod:`harness.nets.defensive`);
    0 is the flow as published. The last network runs again at the rounded sample, so that its
    density is bit for bit the one :meth:`pdf` gives.

    ``lambertian=True`` has the base's network give that share too, from ``uniform`` up to one,
    condition by condition: the Lambertian lobe that the analytic mixtures have. With splines at
    the identity the flow is then the improved baseline, and what the splines add can only help;
    without, it has to bend a Gaussian into a flat disk with a sharp rim where a material is
    near-diffuse.

    ``couplings`` is how many splines in turn, x first; the paper has two. Each more is another
    network to run, twice a sample.

    Deviations from the public release: log sigma and derivatives are bounded smoothly
    instead of left free, last layers start at zero, and the step size is larger, without
    which short fits end far from their plateau.
    """

    name = "neural-spline-flow"
    learning_rate = 1e-2

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("bins", (3, 5, 10, 20, 40), "bins of each spline"),
        Knob("couplings", (1, 2, 3, 4), "splines in turn, alternating x and y"),
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers of a coupling's network"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        width: int = 32,
        bins: int = 20,
        frequencies: int = 4,
        domain: str = "disk",
        uniform: float = 0.01,
        layers: int = 2,
        couplings: int = 2,
        precision: str = "float32",
        lambertian: bool = False,
    ):
        if not 2 <= bins < 500:
            raise InputError(f"{self.name}: bins is {bins}; expected 2 to 499")
        if domain not in ("disk", "square"):
            raise InputError(f"{self.name}: domain is '{domain}'; expected 'disk' or 'square'")
        if min(couplings, layers) < 1:
            raise InputError(
                f"{self.name}: expected at least one of couplings and layers,"
                f" not {couplings} and {layers}"
            )
        self.width, self.layers, self.bins, self.frequencies = width, layers, bins, frequencies
        self.couplings = couplings
        self.square = domain == "square"
        self.uniform = defensive.checked_share(uniform, self.name)
        self.lambertian = lambertian
        self.precision = checked_precision(precision, self.name)

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return SplineFlow(
            material,
            self.width,
            self.layers,
            self.bins,
            self.couplings,
            self.frequencies,
            self.lambertian,
            self.square,
        )

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: the Gaussian at its narrowest and its widest."""
        last = f"base.layers.{len(self.module.base.layers) - 1}"
        return {
            name: held(self.state_dict(), last, slice(2, 4), raw)
            for name, raw in (("scale-to-0", -FAR), ("scale-to-infinity", FAR))
        }

    def share_logit(self, net: SplineFlow, condition: Tensor) -> Tensor | None:
        """See :meth:`FlowMethod.share_logit`."""
        return net.base(net.encoder(condition))[:, 4:] if self.lambertian else None

    def to_base(self, net: SplineFlow, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`FlowMethod.to_base`."""
        encoded = net.encoder(condition)
        mean, raw = net.base(encoded)[:, None, :4].chunk(2, -1)
        log_sigma = lobes.log_sigma(raw)
        at = list(wo.unbind(-1))
        log_slope = -log_sigma.sum(-1)
        if self.square:
            log_chord = _log_chord(at[1])
            at[0] = at[0] * torch.exp(-log_chord)
            log_slope = log_slope - log_chord
        for i, coupling in enumerate(net.couplings):
            own, other = i % 2, 1 - i % 2
            at[own], log_own = spline.warp(coupling(at[other], encoded), at[own])
            log_slope = log_slope + log_own
        return (torch.stack(at, -1) - mean) * torch.exp(-log_sigma), log_slope

    def from_base(self, net: SplineFlow, condition: Tensor, z: Tensor) -> Tensor:
        """See :meth:`FlowMethod.from_base`."""
        encoded = net.encoder(condition)
        mean, raw = net.base(encoded)[:, None, :4].chunk(2, -1)
        at = list((mean + z * torch.exp(lobes.log_sigma(raw))).unbind(-1))
        for i in range(self.couplings - 1, -1, -1):
            own, other = i % 2, 1 - i % 2
            at[own] = spline.unwarp(net.couplings[i](at[other], encoded), at[own])
        if self.square:
            at[0] = at[0] * torch.exp(_log_chord(at[1]))
        return torch.stack(at, -1)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        net = self.module
        encoded = net.encoder.encoded(c)
        mean, log_sigma, share = base = self._base(encoded)
        elsewhere = u[2] < share
        there = defensive.uniform_disk_columns(u)
        at = [
            dr.fma(z, dr.exp(s), m)
            for z, s, m in zip(unit_normal_columns(u), log_sigma, mean, strict=True)
        ]
        wo, back = net.map.draw_columns(at, encoded, elsewhere, there)
        return *wo, self._density(base, back, wo)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        encoded = self.module.encoder.encoded(c)
        back = self.module.map.to_base_columns(wo, encoded)
        return self._density(self._base(encoded), back, wo)

    def _base(self, encoded: Encoded) -> tuple[Columns, Columns, Float | float]:
        """The Gaussian's mean and log sigma, and the uniform share."""
        out = self.module.base.columns(encoded)
        share = self.uniform
        if self.lambertian:
            share = defensive.share_columns(out[4], self.uniform)
        return out[:2], [lobes.log_sigma_columns(raw) for raw in out[2:4]], share

    def _density(
        self,
        base: tuple[Columns, Columns, Float | float],
        back: tuple[Float, Float, Float],
        wo: Columns,
    ) -> Float:
        """Density at ``wo``; ``back`` is its point of the base, and the determinant."""
        x, y, slope = back
        (mx, my), (sx, sy), share = base
        zx, zy = (x - mx) * dr.exp(-sx), (y - my) * dr.exp(-sy)
        normal = dr.exp(-0.5 * dr.fma(zx, zx, zy * zy) - sx - sy - lobes.LOG_2PI)
        return defensive.mixed_columns(normal * slope, wo, share)


def _log_chord(y: Tensor) -> Tensor:
    """Log of half the disk's width at ``y``, or zero."""
    squared = (1 - y) * (1 + y)
    return 0.5 * torch.where(squared > 0, squared, 1).log()
