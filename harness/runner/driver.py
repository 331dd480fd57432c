"""Drives a run: hands tasks to an executor in an order that they allow, and stores the answers."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from harness.core import machine, registry
from harness.core.protocol.errors import InputError
from harness.identity.verdict import short
from harness.measures.base import Outcome
from harness.runner import shipped
from harness.runner.carry_out import number
from harness.runner.executor import Executor
from harness.runner.probes import Probes
from harness.runner.progress import Progress
from harness.runner.task import MEASURE, Answer, Fitted, Task, is_ours
from harness.runner.todo import FINAL, Group, Unit, needed_fits
from harness.runner.validity import Validity
from harness.store import code, write
from harness.store.files import DamagedFile
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial


@dataclass
class _Given:
    """A group that is being carried out."""

    group: Group
    task: Task


class Driver:
    """Carries out the units of one run."""

    def __init__(
        self,
        plan: Plan,
        results: ResultsFolder,
        stored: dict[str, Stored],
        validity: Validity,
        progress: Progress,
        execute: Executor,
        refit: bool = False,
        doubtful: frozenset[str] = frozenset(),
    ):
        self.plan, self.results, self.stored, self.progress = plan, results, stored, progress
        self.validity, self.refit, self.doubtful = validity, refit, doubtful
        self.execute = execute
        self.probes = Probes(plan, results, validity, execute)
        validity.probed = self.probes.same
        self._measured: list[Trial] = []
        self._count = 0
        self._open: set[str] = set()
        """Fits that are still to be made."""

    def run(self, units: Sequence[Unit]) -> None:
        """All units: one after the other, or side by side where the executor has the room."""
        together = [list(units)] if self.execute.slots > 1 else [[unit] for unit in units]
        for some in together:
            fits = [Group([trial]) for unit in some for trial in unit.fits]
            self._open |= {trial.hash for unit in some for trial in unit.fits}
            groups = [group for unit in some for group in unit.groups]
            self._carry_out(fits + [g for g in groups if not _timed(g)])
            timed = [part for g in groups if _timed(g) for part in self._fair(g)]
            self._carry_out(timed)
            self.probes.keep(self._measured, self.progress.note)
            self._measured.clear()

    def _fair(self, group: Group) -> list[Group]:
        """Methods of ours are timed together; any other alone with the baseline.

        What such a method does to its process is then beside no number but its own.
        """
        if not self.execute.isolated:
            return [group]
        base = group.extra or self.plan.baseline_of(group.trials[0])
        measured = [t for t in group.trials if t.hash == base.hash]
        together = [base] if is_ours(base.method_name) else []
        others = []
        for trial in group.trials:
            if trial.hash == base.hash:
                continue
            (together if together and is_ours(trial.method_name) else others).append(trial)
        first = [t for t in together if t is not base] + measured
        parts = [Group(first, None if measured else base)] if first else []
        return parts + [Group([trial], base) for trial in others]

    # --- handing out ---------------------------------------------------------------------------

    def _carry_out(self, groups: Sequence[Group]) -> None:
        """As many groups at a time as the executor takes, each once its fits are there.

        All of them are timed, or none is.
        """
        pending, running = deque(groups), dict[int, _Given]()
        last = ""
        while pending or running:
            first = next(iter(pending), None)
            alone = first is not None and _timed(first)
            slots = self.execute.timed_slots if alone else self.execute.slots
            while len(running) < slots and (group := self._next(pending, running, last)):
                given = self._given(group)
                if given is not None:
                    self._count += 1
                    running[self._count] = given
                    self.progress.begin(given.group.trials)
                    self.execute.submit(self._count, given.task)
            if pending and not running:
                continue  # what was left could not be carried out, and is stored
            for key, answer in self.execute.wait():
                given = running.pop(key)
                last = given.task.first.material
                pending.extendleft(reversed(self._answered(given, answer)))

    def _next(
        self, pending: deque[Group], running: Mapping[int, _Given], last: str
    ) -> Group | None:
        """The next group that can be carried out: of the material that a worker has just had,
        else of one that nobody has, else any."""
        ready = [g for g in pending if self._fitted(g)]
        taken = {given.task.first.material for given in running.values()}

        def order(group: Group) -> int:
            material = group.trials[0].material
            return 0 if material == last and material not in taken else 1 + (material in taken)

        found = min(ready, key=order, default=None)
        if found is not None:
            pending.remove(found)
        return found

    def _fitted(self, group: Group) -> bool:
        needed = {fit for t in group.trials for fit in needed_fits(self.plan, t)}
        return not needed & self._open

    def _given(self, group: Group) -> _Given | None:
        """What of a group is to be carried out; None if nothing is, which is then stored."""
        ready = []
        for trial in group.trials:
            if trial.measure == FIT and self._adopt(trial):
                continue
            if trial.hash in self.doubtful and self.validity.stands(trial):
                self.progress.finish(trial, Outcome(), 0.0)  # its fit gave the same state again
                continue
            outcome = self._blocked(trial)
            if outcome is None:
                ready.append(trial)
            else:
                self._save(trial, outcome, _utc(), 0.0)
        if not ready:
            return None
        extra = group.extra if ready[0].timed else None
        if extra is not None and extra in ready:
            extra = None
        everybody = [*([extra] if extra else []), *ready]
        try:
            fits = {t.fit: Fitted.of(self.stored[t.fit]) for t in everybody if t.fit}
        except DamagedFile as error:  # since the run began
            for trial in ready:
                self._save(trial, Outcome("error", str(error)), _utc(), 0.0)
            return None
        task = Task(MEASURE, tuple(everybody), self.plan.baseline, fits, extra is not None)
        return _Given(Group(ready, extra), task)

    def _adopt(self, trial: Trial) -> bool:
        """Store the fit that comes with the harness instead of running it, if there is one."""
        path = None if self.refit else shipped.find(trial)
        if path is None:
            return False
        outcome, about = shipped.load(path)
        number(trial, outcome)
        when = about["started"], about["seconds"], about["environment"]
        self._save(trial, outcome, *when, path.name, about["parts"])
        return True

    def _blocked(self, trial: Trial) -> Outcome | None:
        """Why a trial cannot be carried out at all, if so."""
        if trial.measure == FIT:
            return None
        needed = {f"the fit of {trial.method}": trial.fit}
        if trial.timed and trial.method != self.plan.baseline:
            base = self.plan.baseline_of(trial)
            needed[f"the fit of the baseline {base.method}"] = base.fit
        for what, fit in needed.items():
            found = self.stored[fit]
            if found.status == "unsupported" and fit == trial.fit:
                return Outcome("unsupported", found.reason)
            if found.status != "ok":
                return Outcome("skipped", f"{what} ended as {found.status}: {found.reason}")
        return None

    # --- answers -------------------------------------------------------------------------------

    def _answered(self, given: _Given, answer: Answer) -> list[Group]:
        """Store what came back; groups to be carried out instead if nothing did."""
        group, task = given.group, given.task
        if answer.died and len(group.trials) > 1:
            # Each alone with the baseline, to find out which of them it was.
            base = group.extra or self.plan.baseline_of(group.trials[0])
            return [Group([t], None if t.hash == base.hash else base) for t in group.trials]
        outcomes = answer.outcomes
        whose = [t.method for t in group.trials]
        who = whose[0] if len(whose) == 1 else f"one of {len(whose)} methods timed together"
        answer.findings = [f"{who} {found}" for found in answer.findings]
        if answer.died:
            dead = Outcome(answer.status, answer.died, traceback=answer.said)
            outcomes = [replace(dead) for _ in task.trials]
        for trial, outcome in zip(task.trials, outcomes, strict=True):
            if task.extra and trial is task.first:
                known = self.stored.get(trial.hash)
                if known is not None and known.status in FINAL:
                    continue  # it ran along to be compared with; what is stored stays
                if task.owner:
                    continue  # it ran beside an adapter that may do anything
            self._save(trial, outcome, answer.started or _utc(), answer.seconds, answer=answer)
        return []

    def _save(
        self,
        trial: Trial,
        outcome: Outcome,
        started: str,
        seconds: float,
        environment: dict[str, Any] | None = None,
        origin: str = "",
        parts: Mapping[str, str] | None = None,
        answer: Answer | None = None,
    ) -> None:
        answer = answer or Answer()
        about = Stored(
            hash=trial.hash,
            trial=trial.identity,
            labels=trial.labels,
            status=outcome.status,
            reason=outcome.reason,
            environment=environment or answer.environment or machine.describe(trial.budget.device),
            started=started,
            seconds=round(seconds, 3),
            fit=trial.fit,
            shipped=origin,
            effects=answer.choices.get(trial.hash, {}),
            parts=self.validity.parts(trial) | dict(parts or {}),
            entries=self.validity.entries(trial),
            analysis=self.validity.analysis(trial.measure),
            findings=answer.findings,
        )
        try:
            stored = write.save(self.results, about, outcome)
        except InputError:
            raise  # of the folder: it is full, or cannot be written
        except (TypeError, ValueError, RuntimeError) as error:
            outcome = Outcome(
                "error",
                f"the outcome cannot be stored: {registry.oneline(error)}",
                traceback=traceback.format_exc(),
            )
            about = replace(about, status=outcome.status, reason=outcome.reason)
            stored = write.save(self.results, about, outcome)
        code.note_units(
            self.results, {s.digest: short(s.units) for s in self.validity.sources(trial).values()}
        )
        self.stored[trial.hash] = stored
        self._open.discard(trial.hash)
        if outcome.status == "ok":
            self._measured.append(trial)
        # What came ready says nothing about the time that is left.
        self.progress.finish(trial, outcome, 0.0 if origin else seconds)


def _timed(group: Group) -> bool:
    return group.trials[0].timed


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
