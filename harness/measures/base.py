"""What a measure is: jobs in, outcomes out.

A measure takes fitted methods and returns raw data. It knows nothing of suites, hashes or
files; the runner gives it jobs, stores what comes back, and has the records made of it by
:mod:`harness.analysis.records`. One measure is one file of this folder, with one class whose
``name`` is the measure's name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict

from harness.core.record import Record

if TYPE_CHECKING:
    import numpy as np
    import torch

    from harness.core.protocol.material import Material
    from harness.core.protocol.method import Budget, Method

Status = Literal["ok", "skipped", "unsupported", "timeout", "error", "nonfinite"]
FAILED = ("error", "timeout", "nonfinite")
"""Statuses that make a run end with exit status 1."""


@dataclass
class Outcome:
    """What one job gave. ``Outcome(arrays={...})`` is a success.

    ``arrays`` are raw outputs from which all records can be made (moments of every batch, every
    timing sample), stored compressed; ``documents`` the same as JSON, for what is no array.
    ``images`` [H, W, 3] are stored as EXR in half precision; ``tensors`` are the state of a
    fitted method, None where there is none to store. ``records`` are of a measure that has no
    file in :mod:`harness.analysis.records` and gives its numbers itself.
    """

    status: Status = "ok"
    reason: str = ""
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    images: dict[str, np.ndarray] = field(default_factory=dict)
    tensors: dict[str, torch.Tensor] | None = None
    documents: dict[str, Any] = field(default_factory=dict)
    traceback: str = ""
    records: list[Record] = field(default_factory=list)


@dataclass
class Job:
    """One trial to be measured.

    ``method`` is fitted to ``material`` and restored from its stored state, except for the
    measure ``fit``, which gets it fresh. ``make()`` constructs another, unfitted one. ``seed``
    is the trial's; ``generator`` is seeded from it and from the measure's name alone, so that
    all methods see the same random conditions. ``baseline`` marks the suite's reference method.
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
    make: Callable[[], Method]
    baseline: bool = False
    fit_records: dict[str, float] = field(default_factory=dict)


class Settings(BaseModel):
    """A measure's settings, as written in a suite: no unknown keys, no silent conversion."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Measure(ABC):
    """One way to measure a fitted method.

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

    @classmethod
    def on_machine(cls) -> bool:
        """Whether this measure's numbers belong to the machine they were taken on."""
        return cls.timed if cls.machine_bound is None else cls.machine_bound

    @classmethod
    def why_not(cls, scene: Any) -> str:
        """Why the measure says nothing of that scene, where it is not planned then; else ""."""
        return ""

    @classmethod
    def later_processes(cls, first: Outcome) -> dict[str, Any]:
        """Settings of a job in the processes that repeat it, after what the ``first`` found.

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
