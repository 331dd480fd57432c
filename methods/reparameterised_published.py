"""Reparameterisation as published: one small network maps normal points to directions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.columns.reflectance import reflectance_columns
from harness.core.protocol.errors import InputError, StateRefused, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Knob
from harness.fitting.map_degree import MapReport, examine
from harness.fitting.module_method import ModuleMethod
from harness.fitting.reverse import LEAST, Pool, normal_of_uniforms, stratified_uniforms, target_of
from harness.fitting.train import minimise
from harness.nets import hemisphere
from harness.nets.coupling import unit_normal_columns
from harness.nets.encoding import ConditionEncoder
from harness.nets.mlp import MLP
from harness.nets.tangents import slopes_by_last, slopes_by_last_columns

BLEND = 1e-3
"""alpha: the share of the fixed map in what is maximised."""
EXAMINED = 16
"""Conditions in which a state is examined."""
TOLERATED = 1e-3
"""Share of p* that a certified map may miss or repeat: the rim, which no z reaches."""
FURTHEST_LOG = 20.0
"""Log of the largest pdf that the guess may be, and of the smallest with a minus."""
_LOG_2PI = math.log(2 * math.pi)


class PiEncoder(ConditionEncoder):
    """Sines and cosines at :math:`2^l \\pi` instead of :math:`2^l`; ``wi`` itself times pi too."""

    def forward(self, condition: Tensor) -> Tensor:
        """See :meth:`ConditionEncoder.forward`."""
        return super().forward(torch.cat([condition[..., :-2], math.pi * condition[..., -2:]], -1))

    def columns(self, c: Columns) -> list[Float]:
        """See :meth:`ConditionEncoder.columns`."""
        return super().columns([*c[:-2], *(math.pi * v for v in c[-2:])])


class MapAndDensity(nn.Module):
    """``map`` (condition, z) -> (a, b, c), SiLU; ``density`` (condition, wo) -> log pdf, ReLU."""

    def __init__(self, material: Material, width: int, layers: int, frequencies: int):
        super().__init__()
        self.encoder = PiEncoder(material.n_address, material.n_features, frequencies)
        inputs = self.encoder.width + 2
        self.map = MLP([inputs, *[width] * layers, 3], "silu")
        self.density = MLP([inputs, width, width, 1])


class ReparameterisedPublished(ModuleMethod, ColumnMethod):
    r"""One network, one step, no inverse: Wu et al. (2025). **Nothing makes it unbiased.**

    A network T of the condition and of z ~ N(0, I) gives the direction; its three outputs go
    through :mod:`harness.nets.hemisphere`, so every sample is above the horizon. The estimate is

    .. math:: w = f(T(z))\,\frac{\det J_T(z)}{N(z)}, \qquad
              E[w] = \int f(\omega)\,\deg(T, \omega)\,d\omega

    with J by forward differentiation in the pass that gives T(z), and the determinant with its
    sign. The degree counts the preimages of a direction with their signs. Where it is one, the
    mean is right even if T folds; where no z is mapped to (degree 0) energy is lost, where T
    covers twice it counts twice. Nothing in the form rules that out, so :meth:`report` measures
    it (:mod:`harness.fitting.map_degree`), and every fit says what was found.

    **Training** (reverse KL, :mod:`harness.fitting.reverse`) maximises

    .. math:: E_z \log\big((1 - \alpha)\,f(T(z)) \max(\det J, 0)
              + \alpha\,f(T_0(z)) \det J_0\big), \quad
              T_0(z) = \frac{z}{\sqrt{1 + |z|^2}}, \quad \det J_0 = (1 + |z|^2)^{-2}

    with :math:`\alpha = 10^{-3}`: f and its gradient are needed and no samples of p*; a mode that
    no sample meets is left out. f is the target of the harness, absolute luminance (the
    release: mean of the channels), plus 1e-14.

    **The pdf** is another network's guess, fitted afterwards to N(z) / \|det J\| by the mean
    absolute error of logarithms. ``exact_pdf`` is false: it weighs strategies in multiple
    importance sampling, and nothing is divided by it.

    ``width`` 16 and ``layers`` 3 of the map are the paper's; the density's network has two hidden
    layers of that width. Four frequencies of the condition. Deviations: single precision; a larger
    step size, without which short fits end far from their plateau; a guess that is kept between
    e^-20 and e^20, for one that underflows gives a valid sample no density. ``certified=True``
    refuses a state that folds or whose degree is not one.

    Of ``harness check`` it fails what ``fails`` names: its weights, where the map misses more than
    their noise hides. Their variance need not exist either (the check's tail index says so).

    Uses two uniforms. Needs a material that gives the gradient of f.

    Raises:
        Unsupported: the material gives no gradient.
        StateRefused: ``certified``, and the map folds, misses or repeats.
    """

    name = "reparameterised-published"
    uniforms = 2
    exact_pdf = False
    fails: ClassVar[tuple[str, ...]] = ("weights",)
    """Properties of ``harness check`` that it is known not to have."""
    learning_rate = 5e-3
    weight_decay = 0.0

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("width", (8, 16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (1, 2, 3, 4), "hidden layers of the map's network"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps of each network"),
    )

    def __init__(
        self, width: int = 16, layers: int = 3, frequencies: int = 4, certified: bool = False
    ):
        if min(width, layers) < 1 or frequencies < 0:
            raise InputError(
                f"{self.name}: expected at least one of width and layers and no negative"
                f" frequencies, not {width}, {layers} and {frequencies}"
            )
        self.width, self.layers, self.frequencies = width, layers, frequencies
        self.certified = certified

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the material gives the gradient of f."""
        reason = material.why_no_gradient()
        return not reason, reason

    def build(self, material: Material) -> nn.Module:
        """See :meth:`ModuleMethod.build`."""
        return MapAndDensity(material, self.width, self.layers, self.frequencies)

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`: a guess has no other route to it."""
        return None

    # --- fitting -----------------------------------------------------------------------

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`; first the map, then the pdf network, ``budget.steps`` each."""
        able, reason = self.supports(material)
        if not able:
            raise Unsupported(reason)
        self.material = material
        seed = int(torch.randint(1 << 62, (), generator=generator))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.module = self.build(material)
        if budget.steps == 0:
            return FitReport()
        pool = Pool.draw(material, budget, generator)
        self.module.to(budget.device).encoder.standardise(pool.condition)
        rates = {"learning_rate": self.learning_rate, "weight_decay": self.weight_decay}
        half = budget.less(pool.seconds, 2)
        first = minimise(
            self.module.map, lambda: self._map_loss(pool, budget, generator), pool, half, **rates
        )
        left = replace(half, max_seconds=budget.max_seconds - first.optimise_seconds)
        second = minimise(
            self.module.density,
            lambda: self._density_loss(pool, budget, generator),
            pool,
            left,
            **rates,
        )
        report = self.report()
        self.refuse_uncertified(report)
        parts = zip(first.part_seconds, second.part_seconds, strict=False)
        black = f"; {pool.black} black conditions left out" if pool.black else ""
        return FitReport(
            steps=first.steps + second.steps,
            parameters=first.parameters + second.parameters,
            data_seconds=pool.seconds,
            optimise_seconds=first.optimise_seconds + second.optimise_seconds,
            loss=first.loss,
            notes=report.line() + black,
            part_seconds=[a + b for a, b in parts],
        )

    def map(self, condition: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """T: directions [B, D, 2] and det J [B, D] of ``condition`` [B, C] and ``z`` [B, D, 2]."""
        raw, slopes = slopes_by_last(self.module.map, self.module.encoder(condition), z)
        return hemisphere.direction_and_determinant(raw, slopes)

    def _points(self, pool: Pool, budget: Budget, generator: torch.Generator):
        condition = pool.batch(budget.conditions, generator)
        u = stratified_uniforms(len(condition), budget.directions, generator, condition.device)
        return condition, normal_of_uniforms(u)

    def _map_loss(self, pool: Pool, budget: Budget, generator: torch.Generator) -> Tensor:
        condition, z = self._points(pool, budget, generator)
        wo, det = self.map(condition, z)
        found = (target_of(self.material, condition, wo) + LEAST) * torch.relu(det)
        apart = 1 + z.square().sum(-1)
        with torch.no_grad():
            fixed = self.material.target_grid(condition, z / apart[..., None].sqrt()) + LEAST
        value = (1 - BLEND) * found + BLEND * fixed / apart.square()
        return -value.log().mean()

    def _density_loss(self, pool: Pool, budget: Budget, generator: torch.Generator) -> Tensor:
        condition, z = self._points(pool, budget, generator)
        with torch.no_grad():
            wo, det = self.map(condition, z)
            log_pdf = -0.5 * z.square().sum(-1) - _LOG_2PI - det.abs().log()
        encoded = self.module.encoder(condition)[:, None].expand(-1, z.shape[1], -1)
        raw = self.module.density(torch.cat([encoded, wo], -1))[..., 0]
        guess = FURTHEST_LOG * torch.tanh(raw / FURTHEST_LOG)
        # On a crease the density has no logarithm, and nothing to be learned.
        there = log_pdf.isfinite()
        return torch.where(there, guess - torch.where(there, log_pdf, 0), 0).abs().mean()

    # --- what the map does -------------------------------------------------------------

    def report(self, conditions: int = EXAMINED, seed: int = 0) -> MapReport:
        """Folds, holes and the bias they make, in ``conditions`` random conditions."""
        if self.material is None:
            raise RuntimeError(f"{self.name}: used before fit or bind")
        generator = torch.Generator().manual_seed(seed)
        device = str(next(self.module.parameters()).device)
        condition = self.material.conditions(conditions, generator, device)
        return examine(self.map, self.material, condition, generator)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """See :meth:`Method.load_state_dict`; a ``certified`` method refuses what folds."""
        super().load_state_dict(state)
        if self.certified:
            self.refuse_uncertified(self.report())

    def refuse_uncertified(self, report: MapReport) -> None:
        """:class:`StateRefused` if ``certified`` and the map is not seen to be one to one."""
        off = report.missed + report.repeated
        if self.certified and (report.folded > 0 or off > TOLERATED):
            raise StateRefused(
                f"{self.name}: state refused: {report.line()}; expected no negative determinant and"
                f" degree one on all but {TOLERATED:.1%} of p*",
                max(report.folded, off),
            )

    # --- sampling ----------------------------------------------------------------------

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """See :meth:`ColumnMethod.sample_weighted_columns`."""
        encoded = self.module.encoder.columns(c)
        seen = [*encoded, *unit_normal_columns(u)]
        raw, slopes = slopes_by_last_columns(self.module.map, seen, 2)
        x, y, det = hemisphere.direction_and_determinant_columns(raw, slopes)
        # 1 / N(z), for |z|^2 = -2 log(1 - u).
        scale = det * (2 * math.pi / (1 - u[0]))
        weight = [v * scale for v in reflectance_columns(self.material, c, [x, y])]
        return x, y, self._pdf(encoded, x, y), weight

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`; the density is the pdf network's guess."""
        return self.sample_weighted_columns(c, u)[:3]

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`; a guess."""
        return self._pdf(self.module.encoder.columns(c), *wo)

    def _pdf(self, encoded: Columns, x: Float, y: Float) -> Float:
        raw = self.module.density.columns([*encoded, x, y])[0]
        guess = dr.exp(FURTHEST_LOG * dr.tanh(raw * (1 / FURTHEST_LOG)))
        inside = dr.fma(x, x, y * y) < 1
        # A nan compares with nothing, and has to come out as one.
        return dr.select(inside | dr.isnan(guess), guess, 0)
