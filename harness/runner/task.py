"""What is handed to whoever carries a piece of work out, and what comes back: content, no paths.

Only the driver of a run reads and writes its results folder. Fitted states travel in the task.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from harness.core import registry
from harness.identity.digests import Part
from harness.measures.base import Outcome
from harness.store.files import checked
from harness.store.stored import STATE, Stored
from harness.suite.trials import FIT, Trial

if TYPE_CHECKING:
    import numpy as np
    import torch

MEASURE, PROBE, CHECK = "measure", "probe", "check"
"""Kinds of tasks: trials to measure, a probe of a part of a trial, an adapter to construct."""


@dataclass(frozen=True)
class Fitted:
    """A stored fit: its records, and the state as the bytes of a safetensors file."""

    records: list[dict[str, Any]]
    state: bytes

    @classmethod
    def of(cls, stored: Stored) -> Fitted:
        """By content.

        Raises:
            DamagedFile: the state is not what was stored.
        """
        state = b""
        if stored.has_state and stored.folder is not None:
            state = checked(stored.folder, STATE, stored.files[STATE]).read_bytes()
        return cls(stored.records, state)

    def tensors(self, device: str = "cpu") -> dict[str, torch.Tensor]:
        """State of the fitted method."""
        if not self.state:
            return {}
        from safetensors.torch import load

        return {name: tensor.to(device) for name, tensor in load(self.state).items()}


@dataclass(frozen=True)
class Task:
    """``trials`` that one call of a measure carries out together, or one trial to probe or check.

    ``extra`` is the first of them where it only runs along to be compared with. ``fits`` are by
    key. A probe is of ``part``, whose code begins at ``begins``; with its work if it is ``timed``.
    """

    kind: str
    trials: tuple[Trial, ...]
    baseline: str
    fits: Mapping[str, Fitted] = field(default_factory=dict)
    extra: bool = False
    part: str = ""
    begins: Mapping[str, Part] = field(default_factory=dict)
    timed: bool = False

    @property
    def first(self) -> Trial:
        """The trial that says what is done."""
        return self.trials[0]

    @property
    def alone(self) -> bool:
        """Whether nothing of ours may run beside it on its machine."""
        return self.kind == MEASURE and self.first.timed

    @property
    def is_fit(self) -> bool:
        """Whether a method is fitted."""
        return self.kind == MEASURE and self.first.measure == FIT

    @cached_property
    def owner(self) -> str:
        """Who shares a process with it: the labels of methods that are not ours, "" for ours alone.

        Two entries of one adapter are two owners.
        """
        labels = {t.method for t in self.trials if not is_ours(t.method_name)}
        return "\n".join(sorted(labels))

    def __str__(self) -> str:
        if self.kind == PROBE:
            return f"probe of {self.part} · {self.first}"
        return str(self.first) if self.kind == MEASURE else f"constructor of {self.first.method}"


@dataclass
class Answer:
    """What became of a task.

    ``outcomes`` are one for each trial. ``choices`` say what ``effects: auto`` came to, by trial.
    ``findings`` are what the methods changed that is not theirs. ``died`` is why there is no
    outcome: the process ended, or was ended, with ``status`` to be stored; ``said`` is what it
    printed last.
    """

    outcomes: list[Outcome] = field(default_factory=list)
    choices: dict[str, dict[str, Any]] = field(default_factory=dict)
    findings: list[str] = field(default_factory=list)
    environment: dict[str, Any] = field(default_factory=dict)
    started: str = ""
    seconds: float = 0.0
    probe: dict[str, np.ndarray] | None = None
    refused: str = ""
    died: str = ""
    status: str = "error"
    said: str = ""


def is_ours(method: str) -> bool:
    """Whether a method comes with the harness: its adapter is compared with others every day."""
    return registry.find(method).package == registry.METHODS_PACKAGE
