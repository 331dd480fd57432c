"""What a trial's job is made of: its material, scene and fitted method, each made once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from harness.core import registry
from harness.core.protocol.method import Method
from harness.effects.registry import is_auto
from harness.measures.base import Job
from harness.measures.fit import restore
from harness.runner.task import Fitted
from harness.suite.resolve import Resolved
from harness.suite.trials import FIT, Trial, stream_seed


class Jobs:
    """Makes jobs, and keeps what they share: measures may remember something by the object.

    ``stored`` are the fits by key; a caller that adds to it may ask for jobs that need what was
    added.
    """

    def __init__(
        self,
        baseline: str,
        stored: dict[str, Fitted],
        note: Callable[[str], None],
        resolved: Resolved | None = None,
    ):
        self.baseline, self.stored, self.note = baseline, stored, note
        self.resolved = resolved or Resolved()
        self.choices: dict[str, dict[str, Any]] = {}
        """By trial: what ``effects: auto`` came to, and why."""
        self._without_auto_of: dict[str, tuple[Any, Any]] = {}
        self._fitted: dict[str, Method] = {}

    def make(self, trial: Trial) -> Job:
        """The job of ``trial``; a method comes unfitted for the measure ``fit`` alone."""

        def make() -> Method:
            return registry.make(trial.method_name, **trial.params)

        fresh = trial.measure == FIT
        return Job(
            trial=trial,
            material=self.resolved.material(trial),
            method=make() if fresh else self._restored(trial, make),
            scene=self.scene(trial),
            seed=trial.seed,
            generator=torch.Generator().manual_seed(stream_seed(trial.measure, trial.seed)),
            settings=dict(trial.settings),
            budget=trial.budget,
            make=make,
            baseline=trial.method == self.baseline,
            fit_records={}
            if fresh
            else {r["metric"]: r["value"] for r in self.stored[trial.fit].records},
        )

    def forget_methods(self) -> None:
        """Free the fitted methods: those of one material are of no use for the next."""
        self._fitted.clear()

    def scene(self, trial: Trial) -> Any | None:
        """The scene of ``trial``, with what ``auto`` stands for; None for one without."""
        scene = self.resolved.scene(trial)
        return self._without_auto(trial, scene) if scene and is_auto(scene.effects) else scene

    def _without_auto(self, trial: Trial, scene: Any) -> Any:
        """The scene with what ``auto`` stands for here; why is stored with every trial."""
        key = f"{trial.scene}\0{trial.material}"
        if key not in self._without_auto_of:
            from harness.measures.auto import resolve

            self._without_auto_of[key] = resolve(scene, self.resolved.material(trial), self.note)
        found, choice = self._without_auto_of[key]
        self.choices[trial.hash] = choice.as_json()
        return found

    def _restored(self, trial: Trial, make: Callable[[], Method]) -> Method:
        if trial.fit not in self._fitted:
            state = self.stored[trial.fit].tensors(trial.budget.device)
            self._fitted[trial.fit] = restore(make(), self.resolved.material(trial), state)
        return self._fitted[trial.fit]
