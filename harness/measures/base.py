"""What a measure is: jobs in, outcomes out.

A measure takes fitted methods and returns numbers. It knows nothing of suites, hashes or
files; the runner gives it jobs and stores what comes back. One measure is one file of this
folder, with one class whose ``name`` is the measure's name.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    import numpy as np
    import torch

    from harness.core.protocol.material import Material
    from harness.core.protocol.method import Budget, Method

Status = Literal["ok", "skipped", "unsupported", "timeout", "error", "nonfinite"]
FAILED = ("error", "timeout", "nonfinite")
"""Statuses that make a run end with exit status 1."""


@dataclass(frozen=True)
class Record:
    """One measured number, its unit and its interval (nan bounds where there is none)."""

    metric: str
    value: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    unit: str = ""


@dataclass
class Outcome:
    """What one job gave. ``Outcome(records=[...])`` is a success.

    ``arrays`` are raw outputs (per-batch moments, every timing sample), stored compressed;
    ``images`` [H, W, 3] are stored as EXR in half precision; ``tensors`` are the state of a
    fitted method, None where there is none to store.
    """

    status: Status = "ok"
    reason: str = ""
    records: list[Record] = field(default_factory=list)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    images: dict[str, np.ndarray] = field(default_factory=dict)
    tensors: dict[str, torch.Tensor] | None = None
    traceback: str = ""


@dataclass
class Job:
    """One trial to be measured.

    ``method`` is fitted to ``material`` and restored from its stored state, except for the
    measure ``fit``, which gets it fresh. ``make()`` constructs another, unfitted one. ``seed``
    is the trial's; ``generator`` is seeded from it and from the measure's name alone, so that
    all methods see the same random conditions. Files written to ``out_dir`` become part of the
    trial's folder. ``baseline`` marks the suite's reference method.
    ``fit_records`` are the numbers that the method's fit recorded, by metric.
    """

    trial: Any
    material: Material
    method: Method
    scene: Any | None
    seed: int
    generator: torch.Generator
    settings: dict[str, Any]
    budget: Budget
    out_dir: Path
    make: Callable[[], Method]
    baseline: bool = False
    fit_records: dict[str, float] = field(default_factory=dict)


class Settings(BaseModel):
    """A measure's settings, as written in a suite: no unknown keys, no silent conversion."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Measure(ABC):
    """One way to put a number on a fitted method.

    ``timed``: the number depends on the clock. :meth:`run` then gets the methods of one
    (material, scene, seed) together, always with the baseline, so that it can interleave
    them in rounds; nothing else runs meanwhile. Other measures get one job at a time.

    A setting called ``resolution`` takes its default from the suite's or profile's
    ``resolution``.
    """

    name: ClassVar[str] = ""
    timed: ClassVar[bool] = False
    needs_scene: ClassVar[bool] = True
    machine_bound: ClassVar[bool | None] = None
    """Whether the trial's hash covers the machine; by default whether it is ``timed``."""

    Settings: ClassVar[type[Settings]] = Settings
    own_times: ClassVar[tuple[str, ...]] = ()
    """Metrics that say how well the baseline was timed, whose ratios are 1 by definition."""

    @classmethod
    def on_machine(cls) -> bool:
        """Whether this measure's numbers belong to the machine they were taken on."""
        return cls.timed if cls.machine_bound is None else cls.machine_bound

    @classmethod
    def later_sittings(cls, first: Outcome) -> dict[str, Any]:
        """Settings that a job's later sittings have instead, after what its ``first`` found.

        Sizes that were chosen by the clock are to be the same in all, and what need not be
        known so often is left out. By default none.
        """
        return {}

    @abstractmethod
    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """One outcome per job, in order. ``notify`` shows the user what is going on.

        Raise :class:`~harness.core.protocol.Unsupported` or
        :class:`~harness.core.protocol.BudgetExceeded` for those statuses; any other exception
        makes the trial an ``error`` with the exception as its reason.
        """
