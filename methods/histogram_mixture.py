"""The histogram mixture of NeuSample: rotated basis histograms, baked into a table."""

from __future__ import annotations

import copy
import time
from typing import ClassVar, NamedTuple

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Knob
from harness.fitting.module_method import ModuleMethod
from harness.fitting.precision import PRECISIONS, checked_precision
from harness.fitting.targets import Targets
from harness.nets.alias import AliasTables
from harness.nets.basis import BasisHistograms, Volume
from harness.nets.conditional import ConditionalMLP
from harness.nets.extremes import FAR, held
from harness.nets.lobes import softmax_columns
from harness.nets.squares import Squares

LOSSES = ("mse", "kl")
FORMS = {"loss": LOSSES}
ROTATIONS = ("azimuth", "free")


class Gates(NamedTuple):
    """``log_weight`` [B, K]; ``rotation`` [B, K, 2], unit vectors; ``code`` [B, K] in [0, 1]."""

    log_weight: Tensor
    rotation: Tensor
    code: Tensor


class ColumnGates(NamedTuple):
    """The same over columns, the code as the number of its baked level."""

    weight: list[Float]
    rotation: list[tuple[Float, Float]]
    level: list[Float]


class Mixture(nn.Module):
    """The two networks: the condition's gates, and the basis histograms."""

    def __init__(self, gate: ConditionalMLP, basis: BasisHistograms, turn_with_wi: bool):
        super().__init__()
        self.gate, self.basis, self.turn_with_wi = gate, basis, turn_with_wi

    def gates(self, condition: Tensor) -> Gates:
        """Of ``condition`` [B, C]."""
        out = self.gate(condition).unflatten(-1, (-1, 4))
        rotation = _unit(out[..., 1:3])
        if self.turn_with_wi:
            c, s = rotation.unbind(-1)
            x, y = _unit(condition[..., None, -2:]).unbind(-1)
            rotation = torch.stack([c * x - s * y, c * y + s * x], -1)
        return Gates(torch.log_softmax(out[..., 0], -1), rotation, torch.sigmoid(out[..., 3]))

    def gates_columns(self, c: Columns, levels: int) -> ColumnGates:
        """The same over columns; ``levels`` is the number of baked codes."""
        out = self.gate.columns(c)
        wi = _unit_columns(*c[-2:])
        rotation, level = [], []
        for a, b, code in zip(out[1::4], out[2::4], out[3::4], strict=True):
            a, b = _unit_columns(a, b)
            if self.turn_with_wi:
                a, b = dr.fma(a, wi[0], -b * wi[1]), dr.fma(a, wi[1], b * wi[0])
            rotation.append((a, b))
            number = dr.round((levels - 1) * dr.rcp(1 + dr.exp(-code)))
            # Bounded as an integer, so that a row of nan stays inside the table.
            level.append(dr.minimum(dr.uint32_array_t(type(code))(number), levels - 1))
        return ColumnGates(softmax_columns(out[0::4]), rotation, level)


class HistogramMixture(ModuleMethod, ColumnMethod):
    r"""Ten shared histograms, weighted and turned: eqs. 5-7 of Xu et al. (2023), NeuSample.

    .. math:: p(\omega) = \sum_{k=1}^K w_k\, H_k(\omega \mid \omega_k, t_k), \qquad
              \omega_k = R(\omega_i, \phi_k)

    A network F+2-32-32-32-4K of the raw condition gives every basis histogram a weight
    (softmax), an angle :math:`\phi_k` (a 2-vector, normalised) and a latent code
    :math:`t_k \in [0, 1]`. :math:`H_k` lives in the frame whose first axis is the azimuth of
    wi turned by :math:`\phi_k` (``rotation="azimuth"``, equation 6; at wi = 0, which has no
    azimuth, that of (1, 0)), or by the network's angle alone (``"free"``).

    While fitting, the :math:`H_k` are a network 27-64-64-64-64-K of (rotated direction, t),
    softplus at its end, which is normalised over the disk. The release sums unnormalised
    outputs; normalised ones make the weights of equation 5 what they are called. After
    fitting and on loading they are baked: ``levels`` x K histograms of ``resolution``^2
    cells of [-1, 1]^2, held as exact alias tables (:mod:`harness.nets.alias`). A query is the
    small network and K lookups. Only the networks are stored.

    ``loss="mse"`` is equation 7, its integral over the disk estimated with directions half
    uniform, half from p*; ``"kl"`` is the negative log likelihood at directions from p*.
    Either is taken at t and at t rounded to a baked level, plus the squared rounding error.
    Squared error is ruled by the conditions whose lobes are narrowest: at small budgets the
    likelihood fits far better.

    Differences from the release: the pdf is fitted, not the unnormalised BRDF; the networks
    are fitted through a coarse lattice, :class:`~harness.nets.basis.Volume` of
    ``fit_levels`` x ``fit_resolution``^2; ``uniform`` of each histogram is spread evenly, so
    that no place of the disk is left out; rim cells carry their density times the root of
    the share s of them that is inside: of all constants per cell this has least variance.

    Uses three uniforms: the first picks the basis and, with what is left of it, cell or
    alias; the others are bin and place in the cell. Rim cells reach over the rim, so about
    one sample in a hundred of a broad lobe is invalid; the pdf there is the histograms'.
    """

    name = "histogram-mixture"
    learning_rate = 1e-2
    weight_decay = 0.0
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("bases", (2, 5, 10, 20), "basis histograms, K"),
        Knob("levels", (10, 30, 100, 300), "latent codes that are baked, T"),
        Knob("resolution", (16, 32, 64, 128), "cells a side of a baked histogram"),
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3), "hidden layers"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    def __init__(
        self,
        bases: int = 10,
        levels: int = 100,
        resolution: int = 64,
        width: int = 32,
        layers: int = 3,
        basis_width: int = 64,
        basis_layers: int = 4,
        loss: str = "mse",
        rotation: str = "azimuth",
        uniform: float = 0.01,
        fit_levels: int = 8,
        fit_resolution: int = 24,
        precision: str = "float32",
    ):
        for value, known, what in ((loss, LOSSES, "loss"), (rotation, ROTATIONS, "rotation")):
            if value not in known:
                raise InputError(f"{self.name}: {what} is '{value}'; expected one of {known}")
        if levels < 2 or min(fit_levels, fit_resolution) < 3 or not 2 <= resolution <= 128:
            raise InputError(
                f"{self.name}: expected at least 2 levels, fit_levels and fit_resolution of at"
                " least 3, and a resolution from 2 to 128"
            )
        if not 0 < uniform < 1:
            raise InputError(f"{self.name}: uniform is {uniform}; expected a share in (0, 1)")
        self.bases, self.levels, self.resolution = bases, levels, resolution
        self.width, self.layers = width, layers
        self.basis_width, self.basis_layers = basis_width, basis_layers
        self.loss_name, self.rotation, self.uniform = loss, rotation, uniform
        self.precision = checked_precision(precision, self.name)
        self.fit_levels, self.fit_resolution = fit_levels, fit_resolution
        self._baked: tuple[tuple, AliasTables, dict] | None = None

    def build(self, material: Material) -> Mixture:
        """Fresh networks."""
        gate = ConditionalMLP(material, [self.width] * self.layers, 4 * self.bases, frequencies=0)
        basis = BasisHistograms(self.bases, self.basis_width, self.basis_layers, self.uniform)
        return Mixture(gate, basis, self.rotation == "azimuth")

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`; baked at its end."""
        report = super().fit(material, budget, generator)
        start = time.perf_counter()
        self.tables()
        report.notes += f"{'; ' if report.notes else ''}baked in "
        report.notes += f"{time.perf_counter() - start:.2f} s"
        return report

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`; bakes."""
        super().load_state_dict(state)
        self.tables()

    def loss(self, targets: Targets, budget: Budget, generator: torch.Generator) -> Tensor:
        """Equation 7, or the likelihood, with the terms of the quantised code."""
        size = budget.conditions, budget.directions, generator
        if self.loss_name == "mse":
            condition, wo, wanted, share = targets.mixed(*size)
        else:
            condition, wo = targets.batch(*size)
        gates = self.module.gates(condition)
        volume = Volume.random(self.module.basis, self.fit_levels, self.fit_resolution, generator)
        local = _into_frames(wo, gates.rotation)
        code = gates.code.detach()
        quantised = (code * (self.levels - 1)).round() / (self.levels - 1)
        loss = (gates.code - quantised).square().mean()
        for t in (gates.code, quantised):
            pdf = (gates.log_weight.exp()[:, None] * volume.at(local, t)).sum(-1)
            if self.loss_name == "mse":
                loss = loss + (share * (pdf - wanted).square()).mean()
            else:
                loss = loss - pdf.log().mean()
        return loss

    @torch.no_grad()
    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log of the baked density [B, D] at ``wo`` [B, D, 2]: the pdf, by the torch gates."""
        tables, _ = self.tables()
        n, gates = self.resolution, self.module.gates(condition)
        local = _into_frames(wo, gates.rotation)
        x, y = ((local + 1) * (n / 2)).long().clamp(0, n - 1).unbind(-1)
        level = (gates.code * (self.levels - 1)).round().long()
        which = level * self.bases + torch.arange(self.bases, device=level.device)
        value = tables.density.to(wo.device)[(which[:, None] * n + y) * n + x]
        value = torch.where(local.abs().amax(-1) < 1 + 1e-6, value, 0)
        return (gates.log_weight.exp()[:, None] * value).sum(-1).log()

    @torch.no_grad()
    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`: the gates in doubles, over the tables as baked."""
        plain, net = copy.copy(self), self.module
        plain.module = Mixture(copy.deepcopy(net.gate).double(), net.basis, net.turn_with_wi)
        return plain.log_prob(condition.double(), wo.double()[:, None])[:, 0].exp()

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: histograms of few cells, flat ones, all weight on one."""
        state, gate = self.state_dict(), f"gate.mlp.layers.{len(self.module.gate.mlp.layers) - 1}"
        last = f"basis.mlp.layers.{len(self.module.basis.mlp.layers) - 1}"
        alone = state
        for k in range(self.bases):
            alone = held(alone, gate, slice(4 * k, 4 * k + 1), -FAR if k else FAR)
        # Far below zero softplus is exp, and outputs that differ by hundreds leave a few cells.
        weight, bias = (1e3 * state[f"{last}.{key}"] for key in ("weight", "bias"))
        few = {**state, f"{last}.weight": weight, f"{last}.bias": bias - 3e4}
        flat = held(state, last, slice(None), 0.0)
        return {"sigma-to-0": few, "sigma-to-infinity": flat, "uniform-to-0": alone}

    @torch.no_grad()
    def bake(self) -> AliasTables:
        """Histogram ``level * K + k`` for every level and basis; about a second."""
        basis = self.module.basis
        squares = Squares.covering(self.resolution, next(basis.parameters()).device)
        codes = torch.linspace(0, 1, self.levels, device=squares.point.device)
        mass = torch.cat([basis.density(squares, t) for t in codes.split(10)])
        mass = mass.permute(0, 2, 1).flatten(0, 1).double() * squares.share.sqrt()
        return AliasTables.of(squares.spread(mass).cpu(), self.resolution)

    def tables(self, array: type[Float] | None = None) -> tuple:
        """Baked tables, and their columns for ``array``; again whenever a weight changed."""
        version = tuple((p.data_ptr(), p._version) for p in self.module.basis.parameters())
        if self._baked is None or self._baked[0] != version:
            self._baked = (version, self.bake(), {})
        _, tables, columns = self._baked
        if array is not None and array not in columns:
            columns[array] = tables.columns(array)
        return tables, columns.get(array)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        tables, data = self.tables(type(u[0]))
        gates = self.module.gates_columns(c, self.levels)
        weight, below, threshold = gates.weight[0], type(u[0])(0), gates.weight[0]
        (cos, sin), which = gates.rotation[0], gates.level[0] * self.bases
        for k in range(1, self.bases):
            # Weights sum to one but for rounding: whatever is left belongs to the last.
            here = u[0] >= threshold
            weight = dr.select(here, gates.weight[k], weight)
            below = dr.select(here, threshold, below)
            which = dr.select(here, gates.level[k] * self.bases + k, which)
            cos = dr.select(here, gates.rotation[k][0], cos)
            sin = dr.select(here, gates.rotation[k][1], sin)
            threshold = threshold + gates.weight[k]
        x, y = tables.sample_columns(data, which, [(u[0] - below) / weight, u[1], u[2]])
        x, y = dr.fma(cos, x, -sin * y), dr.fma(sin, x, cos * y)
        # The density is that of the point returned: rotation may round it into the next cell.
        return x, y, self._density(gates, x, y)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        return self._density(self.module.gates_columns(c, self.levels), *wo)

    def _density(self, gates: ColumnGates, x: Float, y: Float) -> Float:
        tables, data = self.tables(type(x))
        pdf = type(x)(0)
        for k, ((cos, sin), level) in enumerate(zip(gates.rotation, gates.level, strict=True)):
            lx, ly = dr.fma(cos, x, sin * y), dr.fma(cos, y, -sin * x)
            value = tables.pdf_columns(data, level * self.bases + k, lx, ly)
            pdf = dr.fma(gates.weight[k], value, pdf)
        return pdf


def _into_frames(wo: Tensor, rotation: Tensor) -> Tensor:
    """``wo`` [B, D, 2] in the frames of ``rotation`` [B, K, 2]: [B, D, K, 2]."""
    x, y = wo[:, :, None].unbind(-1)
    c, s = rotation[:, None].unbind(-1)
    return torch.stack([c * x + s * y, c * y - s * x], -1)


def _unit(v: Tensor) -> Tensor:
    """``v`` [..., 2] over its length; (1, 0) for the zero vector, which has no direction."""
    largest = v.detach().abs().amax(-1, keepdim=True)
    zero = largest == 0
    # Scaled before squaring, so that no finite vector over- or underflows.
    v = torch.where(zero, v.new_tensor([1.0, 0.0]), v / torch.where(zero, 1, largest))
    return v / v.norm(dim=-1, keepdim=True)


def _unit_columns(x: Float, y: Float) -> tuple[Float, Float]:
    """:func:`_unit` over columns."""
    largest = dr.maximum(dr.abs(x), dr.abs(y))
    zero = largest == 0
    # Divided: the reciprocal of a denormal number would be infinite.
    largest = dr.select(zero, 1, largest)
    x, y = dr.select(zero, 1, x / largest), y / largest
    scale = dr.rsqrt(dr.fma(x, x, y * y))
    return x * scale, y * scale
