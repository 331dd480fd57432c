"""The adapter: one way to draw directions in proportion to a BSDF."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import BudgetExceeded, Unsupported
from harness.core.protocol.material import Material


class DiskSample(NamedTuple):
    """Sampled directions and their density.

    ``wo`` [N, 2] are points of the projected disk; a point outside the unit disk is an
    *invalid sample*, whose estimate is zero. ``pdf`` [N] is the density with respect to
    disk area at ``wo``, and equals ``method.pdf(condition, wo)``.
    """

    wo: Tensor
    pdf: Tensor


class WeightedSample(NamedTuple):
    """A sample whose estimate is not f/pdf: ``weight`` [N, 3] is the estimate itself.

    ``E[weight]`` over the samples in a region is the integral of f over it (per disk area),
    for an unbiased method. ``wo`` [N, 2] and ``pdf`` [N] as in :class:`DiskSample`, but the
    density is an approximation, which multiple importance sampling may weigh strategies with
    and nothing may be divided by. The weight of an invalid sample is zero.
    """

    wo: Tensor
    pdf: Tensor
    weight: Tensor


@dataclass(frozen=True)
class Budget:
    """How much a fit may spend.

    ``steps`` optimiser steps of ``conditions`` conditions times ``directions`` directions,
    drawn from p* of a pool of ``pool`` conditions. What is drawn is as sharp as the material;
    ``resolution``, of tables that an adapter may make for itself, has no influence on it.
    ``max_seconds`` is a limit, not a goal: a fit that passes it ends as a trial of status
    ``timeout``.

    ``seconds`` replaces ``steps``: the fit takes as many steps as it can in that time, what its
    data take included, and ends with what it has. ``until`` makes ``steps`` a beginning: fits of
    twice the steps follow until the KL on held-out conditions moves by less than that share
    (:mod:`harness.fitting.until`). Not both.
    """

    steps: int = 1000
    conditions: int = 256
    directions: int = 64
    resolution: int = 64
    pool: int = 4096
    device: str = "cpu"
    max_seconds: float = float("inf")
    seconds: float | None = None
    until: float | None = None

    def less(self, seconds: float, parts: int = 1) -> Budget:
        """What is left for each of so many ``parts`` when data took ``seconds`` of the time.

        Raises:
            BudgetExceeded: nothing is left.
        """
        if self.seconds is None:
            return self
        if seconds >= self.seconds:
            raise BudgetExceeded(
                f"its data took {seconds:.3g} s of the {self.seconds:g} s that a fit has"
            )
        return replace(self, seconds=(self.seconds - seconds) / parts)


@dataclass
class FitReport:
    """What a fit did. ``FitReport()`` is right for a method that has nothing to fit."""

    steps: int = 0
    parameters: int = 0
    data_seconds: float = 0.0
    optimise_seconds: float = 0.0
    loss: list[float] = field(default_factory=list)
    notes: str = ""
    bake_seconds: float = 0.0
    """Of turning what was fitted into the tables that are sampled, where a method does."""
    part_seconds: list[float] = field(default_factory=list)
    """Of equal parts of the optimisation, in order: how steadily it went on."""
    validation: list[tuple[int, float]] = field(default_factory=list)
    """Steps of each fit of a budget with ``until``, and its KL on held-out conditions."""


@dataclass(frozen=True)
class Knob:
    """What trades accuracy for time: a constructor's parameter, or ``budget.steps``.

    ``values`` are in order of increasing cost and contain the default.
    """

    name: str
    values: tuple[Any, ...]
    about: str = ""


class Method(ABC):
    """An importance-sampling method for the projected disk.

    A subclass gives :meth:`sample` and :meth:`pdf`; the rest has defaults. Keyword
    arguments of its constructor are its parameters, as written in a suite.

    Shapes: ``condition`` [N, C] as drawn by ``material.conditions``, the last two columns
    ``wi.xy``; ``u`` [N, 3] uniforms in [0, 1); ``wo`` [N, 2]. Densities are with respect to
    disk area. Inputs are never written to. N may be zero.
    """

    name: ClassVar[str] = ""
    uniforms: ClassVar[int] = 3
    """How many of the three columns of ``u`` :meth:`sample` reads."""

    knobs: ClassVar[tuple[Knob, ...]] = ()
    """What trades this method's accuracy for time; swept one at a time by ``sweep: knobs``."""

    exact_pdf: bool = True
    """Whether :meth:`pdf` is the density of :meth:`sample`. Where it only approximates it, as
    for random walks or a network's guess, estimates take the weights of :meth:`sample_weighted`."""

    material: Material | None = None
    """The material last given to :meth:`fit` (or :meth:`bind`)."""

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the method can sample ``material``, and if not, why not."""
        return True, ""

    def bind(self, material: Material) -> None:
        """Say which material the method samples. Called before ``fit`` and after loading."""
        self.material = material

    def rebound(self, material: Material) -> Method:
        """The same method, as fitted, for a ``material`` of the same conditions.

        Such as the one it was fitted to without some of its effects: what was learnt stays,
        and whatever asks the material asks this one.
        """
        other = copy.copy(self)
        other.material = material
        return other

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """Adapt to ``material`` within ``budget``; all randomness comes from ``generator``."""
        self.bind(material)
        return FitReport()

    @abstractmethod
    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """Draw one direction per row from ``u``."""

    def sample_weighted(self, condition: Tensor, u: Tensor) -> WeightedSample:
        """:meth:`sample` with the estimates [N, 3] of its directions.

        By default f/pdf. A method whose pdf is not exact gives weights of its own.
        """
        wo, pdf = self.sample(condition, u)
        weight = self.eval(condition, wo) / pdf[:, None]
        # Off the disk f is zero, and so is the estimate, whatever the density says.
        return WeightedSample(wo, pdf, torch.where(inside_disk(wo)[:, None], weight, 0))

    @abstractmethod
    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Density [N] of :meth:`sample` at ``wo``, per disk area; 0 where it never samples.

        An approximation of it where :attr:`exact_pdf` is false.
        """

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Reflectance [N, 3] at ``wo``, without cosine; by default the material's own."""
        if self.material is None:
            raise RuntimeError(f"{self.name}: eval before fit or bind")
        return self.material.eval(condition, wo)

    def state_dict(self) -> dict[str, Tensor]:
        """Everything a fitted method needs to be restored, as named tensors."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Inverse of :meth:`state_dict`, on a method constructed with the same parameters."""

    # --- what lets ``harness check`` look deeper; every one is optional ------------------------

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """:meth:`pdf` [N] by the plainest route in double precision; None if there is none."""
        return None

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """The uniforms [N, 3] that :meth:`sample` maps to ``wo``; None if the map is not one."""
        return None

    def in_torch(self) -> Method | None:
        """The same sampler in torch alone, to compare times with; None if there is none."""
        return None

    def extremes(self) -> dict[str, dict[str, Tensor]]:
        """Complete states at the ends of the parameters' range, by name (``sigma-to-0``)."""
        return {}

    def size_bytes(self) -> int:
        """Bytes of state as stored."""
        return sum(t.numel() * t.element_size() for t in self.state_dict().values())


def refuse_unsupported(method: Method, material: Material) -> None:
    """For the ``bind`` of a method that :meth:`Method.supports` some materials only.

    Raises:
        Unsupported: this one it does not, with the reason.
    """
    able, reason = method.supports(material)
    if not able:
        raise Unsupported(reason)
