"""Flow matching: a velocity field carries a simple base to the directions, in few or many steps."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.errors import InputError, StateRefused, nearest
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport, Knob
from harness.fitting import flow_matching as losses
from harness.fitting.drawn import Drawn
from harness.fitting.flow_in_torch import FlowInTorch
from harness.fitting.flow_steadiness import Steadiness, steadiness
from harness.fitting.phases import joined
from harness.fitting.precision import PRECISIONS, checked_precision, round_weights
from harness.fitting.steady import SteadyMethod
from harness.fitting.targets import Targets
from harness.fitting.train import minimise
from harness.nets import defensive, discrete_flow_inverse, domains, flow_sampling
from harness.nets.activations import ACTIVATIONS
from harness.nets.conditional_flow import ColumnConditioned, ConditionalFlow
from harness.nets.coupling import uniforms_of_normal
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.extremes import FAR, held
from harness.nets.mixture_base import BASES
from harness.nets.solvers import SOLVERS
from harness.nets.velocity import Shared

TRAININGS = ("matching", "likelihood")


class FlowMatching(SteadyMethod, ColumnMethod):
    r"""Flow matching with the exact density of its few steps: PureSample, sections 5.1 and 6.3.

    A network u(x, t, condition) moves a sample of the base to the direction in S steps of Euler's
    method (or ``midpoint``, ``rk4``),

    .. math:: x_{k+1} = x_k + \tfrac{1}{S}\,u(x_k, \tfrac{k}{S}), \qquad
              p(\omega) = p_0(x_0) \prod_k
              \left|\det \frac{\partial x_{k+1}}{\partial x_k}\right|^{-1}

    As published: ``base`` the standard normal, the disk's own coordinates, five hidden layers of
    64, the regression of eq. 3 (``training="matching"``), and ten steps after one ``reflow``. The
    density is not the published one, which steps back along other points and is that of no
    sampler (``flow-matching-published`` has it), but the discrete map's own: :meth:`sample`
    multiplies the determinants on its way, :meth:`pdf` inverts each step
    (:mod:`harness.nets.discrete_flow`).

    Ours: ``base="gaussian"`` or ``"lobes"`` with a network of their own (Fu et al. 2024 have the
    first); ``domain="plane"``, where the uniform disk *is* the standard normal, or ``"square"``
    (:mod:`harness.nets.domains`); base points and directions paired within a batch (``pairing``);
    ``training="likelihood"``, which maximises the density of the S steps themselves, after a fit by
    matching where there is a ``reflow``. ``budget.steps`` is shared evenly among matching, each
    reflow and likelihood.

    A share ``uniform`` of the samples is uniform on the disk, with ``lambertian`` a condition's own
    share from there up to one. In ``plane`` it is part of the base and costs nothing; elsewhere a
    sample of it has its density by :meth:`pdf`'s way, at a step's inverse each.

    States whose steps are not one to one, or that single precision cannot follow, are refused. Uses
    three uniforms. Per disk area.
    """

    name = "flow-matching"
    uniforms = 3
    origin = "its base point"
    learning_rate = 5e-3
    weight_decay = 0.0

    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("steps", (2, 4, 10, 50), "steps from the base to the direction"),
        Knob("solver", tuple(SOLVERS), "evaluations a step: one, two or four"),
        Knob("width", (16, 32, 64), "neurons of a hidden layer"),
        Knob("layers", (2, 3, 5), "hidden layers"),
        Knob("reflow", (0, 1, 2), "times that it is fitted to its own pairs"),
        Knob("precision", PRECISIONS, "of the weights: bytes on disk, no time"),
        Knob("budget.steps", (100, 300, 1000, 3000), "optimiser steps"),
    )

    module: ConditionalFlow

    def __init__(
        self,
        steps: int = 10,
        solver: str = "euler",
        base: str = "normal",
        domain: str = "disk",
        width: int = 64,
        layers: int = 5,
        activation: str = "silu",
        training: str = "matching",
        reflow: int = 1,
        pairing: bool = False,
        uniform: float = 0.01,
        lambertian: bool = False,
        base_width: int = 32,
        frequencies: int = 5,
        waves: int = 0,
        precision: str = "float32",
    ):
        for key, value, known in (
            ("solver", solver, SOLVERS),
            ("base", base, BASES),
            ("domain", domain, domains.DOMAINS),
            ("activation", activation, ACTIVATIONS),
            ("training", training, TRAININGS),
        ):
            if value not in known:
                raise InputError(f"{self.name}: {key} is '{value}'{nearest(str(value), known)}")
        if min(steps, width, layers, base_width) < 1 or reflow < 0:
            raise InputError(
                f"{self.name}: expected at least one of steps, width, layers and base_width and no"
                f" negative reflow, not {steps}, {width}, {layers}, {base_width} and {reflow}"
            )
        self.steps, self.solver, self.training, self.reflow = steps, solver, training, reflow
        self.pairing, self.domain = pairing, domain
        self.uniform = defensive.checked_share(uniform, self.name)
        self.precision = checked_precision(precision, self.name)
        self.shape: dict[str, Any] = {
            "base": base,
            "base_width": base_width,
            "domain": domain,
            "width": width,
            "layers": layers,
            "activation": activation,
            "frequencies": frequencies,
            "waves": waves,
            "framed": base != "normal",
            "share": self.uniform,
            "own_share": lambertian,
        }

    def build(self, material: Material) -> ConditionalFlow:
        """See :meth:`ModuleMethod.build`."""
        return ConditionalFlow(material, **self.shape)

    def flow(self, net: ConditionalFlow | None = None) -> DiscreteFlow:
        """The steps through the velocity of ``net``, by default the fitted one."""
        return DiscreteFlow((net or self.module).velocity, self.steps, self.solver)

    # --- fitting -----------------------------------------------------------------------

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`.

        Raises:
            StateRefused: a step is not one to one, or moves too much for single precision.
        """
        self.material = material
        seed = int(torch.randint(1 << 62, (), generator=generator))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.module = self.build(material)
        targets = Targets.build(material, budget, generator)
        self.prepare(targets)
        phases = self.phases()
        # Made inside the first phase, so that its time counts.
        drawn = functools.cache(lambda: Drawn(targets, budget.directions, generator))
        reports = []
        for i, phase in enumerate(phases):
            # The first takes what does not divide evenly.
            steps = budget.steps // len(phases) + (budget.steps % len(phases) if i == 0 else 0)
            part = replace(budget.less(targets.seconds, len(phases)), steps=steps)
            loss = self._loss_of(phase, drawn, part, generator)
            reports.append(
                minimise(
                    self.module,
                    loss,
                    targets,
                    part,
                    learning_rate=self.learning_rate,
                    weight_decay=self.weight_decay,
                )
            )
        round_weights(self.module, self.precision)
        self.refuse_unsteady()
        return joined(reports, phases)

    def phases(self) -> list[str]:
        """What a fit does, in order."""
        if self.training == "likelihood" and not self.reflow:
            return ["likelihood"]
        last = ["likelihood"] if self.training == "likelihood" else []
        return ["matching", *["reflow"] * self.reflow, *last]

    def _loss_of(
        self,
        phase: str,
        drawn: Callable[[], Drawn],
        budget: Budget,
        generator: torch.Generator,
    ) -> Callable[[], Tensor]:
        net = self.module
        if phase == "matching":
            return lambda: losses.matching_loss(net, drawn(), budget, generator, self.pairing)
        if phase == "likelihood":
            return lambda: losses.likelihood_loss(
                net, self.steps, self.solver, drawn(), budget, generator
            )
        pairs = functools.cache(lambda: losses.Pairs.of(net, drawn().condition, generator))
        return lambda: pairs().loss(net, budget, generator)

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Log density [B, D]."""
        return self._log_prob(self.module, condition, wo)

    def _log_prob(self, net: ConditionalFlow, condition: Tensor, wo: Tensor) -> Tensor:
        return net.log_prob(self.flow(net), condition, wo)[0]

    # --- whether the state can be run --------------------------------------------------

    def measured(self) -> Steadiness:
        """Shares of samples that are no numbers, that fold, and that rounding moves: see there."""
        if self.material is None:
            raise RuntimeError(f"{self.name}: used before fit or bind")
        return steadiness(self.module, self.flow(), self.material)

    def unsteady(self) -> float:
        """The largest of the shares that are :meth:`measured`."""
        return max(self.measured())

    def refuse_unsteady(self) -> None:
        """:class:`StateRefused` if a sample is no number, folded, or moved, or many at the rim."""
        found = self.measured()
        if found.broken:
            raise StateRefused(
                f"{self.name}: state refused: {found.broken:.2%} of the samples are no numbers: the"
                " velocity or its base is not finite; expected none",
                found.broken,
            )
        if found.folded:
            raise StateRefused(
                f"{self.name}: state refused: in {found.folded:.2%} of the samples one of the"
                f" {self.steps} {self.solver} steps is not one to one (its determinant is not"
                " positive), so that the density would not be that of what is drawn; expected none",
                found.folded,
            )
        if found.moved:
            raise self.moved_by_rounding(found.moved)
        if found.at_rim:
            raise StateRefused(
                f"{self.name}: state refused: {found.at_rim:.2%} of the samples lie within a"
                " millionth of the rim of the disk, where single precision has no densities;"
                " expected next to none",
                found.at_rim,
            )

    # --- what lets a check look deeper -------------------------------------------------

    @torch.no_grad()
    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.inverse`: of the one lobe's branch, in double; None for a mixture."""
        if self.shape["base"] == "lobes" or self.shape["own_share"]:
            return None
        net = copy.deepcopy(self.module).double()
        at = net.at(condition.double())
        place, _ = net.place(at, wo[:, None].double())
        origin = self.flow(net).invert(place, at.shared).x[:, 0]
        z = (origin - at.base.mean[:, -1]) * torch.exp(-at.base.log_sigma[:, -1])
        u = uniforms_of_normal(z)
        # The middle of what is not the uniform share's.
        return torch.cat([u, torch.full_like(u[:, :1], (1 + self.uniform) / 2)], 1)

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """See :meth:`Method.extremes`: the base's Gaussians at their narrowest and widest."""
        net = self.module.base
        if not net.lobes:
            return {}
        last, n = f"base.net.layers.{len(net.net.layers) - 1}", net.lobes
        return {
            name: held(self.state_dict(), last, slice(2 * n, 4 * n), raw)
            for name, raw in (("scale-to-0", -FAR), ("scale-to-infinity", FAR))
        }

    def in_torch(self) -> FlowInTorch:
        """The same sampler by torch, for timings beside it."""
        return FlowInTorch(self, self.flow())

    # --- sampling ----------------------------------------------------------------------

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns` and :func:`flow_sampling.sample`."""
        net = self.module
        return flow_sampling.sample(net, self.flow(), net.at_columns(c), u)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`; not a number where no origin was found."""
        return self._density(self.module.at_columns(c), wo)

    def _density(self, at: ColumnConditioned, wo: Columns) -> Float:
        return flow_sampling.density(self.module, self.flow(), at, wo, self.back)

    def back(self, flow: DiscreteFlow, place: Columns, shared: Shared) -> Any:
        """Where ``place`` comes from, for :meth:`pdf_columns`."""
        return discrete_flow_inverse.invert(flow, place, shared)
