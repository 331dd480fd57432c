"""Carries out units of work. A trial that fails is stored with its reason; the rest goes on."""

from __future__ import annotations

import gc
import math
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import torch

from harness.core import machine, registry
from harness.core.protocol.errors import BudgetExceeded, InputError, Unsupported
from harness.identity.verdict import short
from harness.measures import registry as measures
from harness.measures.adapter_smoke_test import BadAdapter
from harness.measures.base import Job, Outcome
from harness.runner import process_repeats, shipped
from harness.runner.jobs import Jobs
from harness.runner.machine_lock import machine as machine_held
from harness.runner.probes import Probes
from harness.runner.progress import Progress
from harness.runner.todo import FINAL, Group, Unit
from harness.runner.validity import Validity
from harness.store import code, write
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored
from harness.suite.plan import Plan
from harness.suite.trials import FIT, Trial, stream_seed


class Worker:
    """Does the work of one run."""

    def __init__(
        self,
        plan: Plan,
        results: ResultsFolder,
        stored: dict[str, Stored],
        validity: Validity,
        progress: Progress,
        refit: bool = False,
        doubtful: frozenset[str] = frozenset(),
    ):
        self.plan, self.results, self.stored, self.progress = plan, results, stored, progress
        self.validity, self.refit, self.doubtful = validity, refit, doubtful
        self.jobs = Jobs(plan.baseline, stored, progress.note, plan.resolved)
        self.probes = Probes(plan, results, validity, self.jobs)
        validity.probed = self.probes.same
        self._measured: list[Trial] = []

    def unit(self, unit: Unit) -> None:
        """Fit all methods to one material, then measure them."""
        for trial in unit.fits:
            if not self._adopt(trial):
                self._group(Group([trial]))
        for group in unit.groups:
            self._group(group)
        self.probes.keep(self._measured, self.progress.note)
        self._measured.clear()
        self.jobs.forget_methods()
        gc.collect()

    def _adopt(self, trial: Trial) -> bool:
        """Store the fit that comes with the harness instead of running it, if there is one."""
        path = None if self.refit else shipped.find(trial)
        if path is None:
            return False
        outcome, about = shipped.load(path)
        self._number(trial, outcome)
        when = about["started"], about["seconds"], about["environment"]
        self._save(trial, outcome, *when, path.name, about["parts"])
        return True

    # --- one call of a measure -----------------------------------------------------------------

    def _group(self, group: Group) -> None:
        ready = []
        for trial in group.trials:
            if trial.hash in self.doubtful and self.validity.stands(trial):
                self.progress.finish(trial, Outcome(), 0.0)  # its fit gave the same state again
                continue
            outcome = self._blocked(trial)
            if outcome is None:
                ready.append(trial)
            else:
                self._save(trial, outcome, _utc(), 0.0)
        if not ready:
            return
        timed = ready[0].timed
        with machine_held(self.progress.note, alone=timed):
            self._measure(ready, group.extra if timed else None)

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

    def _measure(self, trials: list[Trial], extra: Trial | None) -> None:
        """Run the measure of ``trials`` on them together, and store what comes back."""
        everybody = [*([extra] if extra else []), *trials]
        self.progress.begin(trials)
        started, clock = _utc(), time.perf_counter()
        outcomes = self._outcomes(everybody)
        share = (time.perf_counter() - clock) / len(everybody)
        for trial, outcome in zip(everybody, outcomes, strict=True):
            if trial is extra:
                known = self.stored.get(trial.hash)
                if known is not None and known.status in FINAL:
                    continue  # it ran along to be compared with; what is stored stays
            self._save(trial, outcome, started, share)

    def _outcomes(self, trials: list[Trial]) -> list[Outcome]:
        jobs: list[Job | Outcome] = [_caught(lambda t=t: self.jobs.make(t)) for t in trials]
        for trial, job in zip(trials, jobs, strict=True):
            if trial.timed and trial.method == self.plan.baseline and isinstance(job, Outcome):
                reason = f"the baseline {trial.method} failed: {job.reason}"
                jobs = [x if isinstance(x, Outcome) else Outcome("error", reason) for x in jobs]
                break
        good = [job for job in jobs if isinstance(job, Job)]
        measure = measures.make(trials[0].measure)
        found = _caught(lambda: self._checked_run(measure, good)) if good else []
        if isinstance(found, Outcome):
            found = self._separately(measure, good, found)
        results = iter(found)
        return [finished(job) if isinstance(job, Outcome) else next(results) for job in jobs]

    def _checked_run(self, measure: Any, jobs: list[Job]) -> list[Outcome]:
        first = jobs[0].trial
        if process_repeats.count(measure, first)[1] > 1:
            trials = [job.trial for job in jobs]
            outcomes = process_repeats.run(measure, trials, self.jobs, self.progress.note)
        else:
            torch.manual_seed(stream_seed(first.measure, first.seed))
            outcomes = measure.run(jobs, self.progress.note)
        if len(outcomes) != len(jobs):
            raise RuntimeError(f"{measure.name}: {len(outcomes)} outcomes for {len(jobs)} jobs")
        for job, outcome in zip(jobs, outcomes, strict=True):
            self._number(job.trial, outcome)
        return [finished(outcome) for outcome in outcomes]

    @staticmethod
    def _number(trial: Trial, outcome: Outcome) -> None:
        made = process_repeats.numbers_of(trial.measure, trial.settings, outcome)
        outcome.records, outcome.reason = made.records, made.reason

    def _separately(self, measure: Any, jobs: list[Job], failed: Outcome) -> list[Outcome]:
        """After one of several has failed: each alone with the baseline, to find out which."""
        base = next((job for job in jobs if job.baseline), None)
        if len(jobs) == 1:
            return [failed]
        found = []
        for job in jobs:
            pair = [job] if base is None or job is base else [base, job]
            for each in pair:
                each.generator.manual_seed(stream_seed(each.trial.measure, each.seed))
            outcome = _caught(lambda pair=pair: self._checked_run(measure, pair))
            found.append(outcome if isinstance(outcome, Outcome) else outcome[-1])
        return found

    # --- storing -------------------------------------------------------------------------------

    def _save(
        self,
        trial: Trial,
        outcome: Outcome,
        started: str,
        seconds: float,
        environment: dict[str, Any] | None = None,
        origin: str = "",
        parts: Mapping[str, str] | None = None,
    ) -> None:
        about = Stored(
            hash=trial.hash,
            trial=trial.identity,
            labels=trial.labels,
            status=outcome.status,
            reason=outcome.reason,
            environment=environment or machine.describe(trial.budget.device),
            started=started,
            seconds=round(seconds, 3),
            fit=trial.fit,
            shipped=origin,
            effects=self.jobs.choices.get(trial.hash, {}),
            parts=self.validity.parts(trial) | dict(parts or {}),
            entries=self.validity.entries(trial),
            analysis=self.validity.analysis(trial.measure),
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
        if outcome.status == "ok":
            self._measured.append(trial)
        # What came ready says nothing about the time that is left.
        self.progress.finish(trial, outcome, 0.0 if origin else seconds)


def finished(outcome: Outcome) -> Outcome:
    """``outcome``, as nonfinite if it is a success that holds a number which is none."""
    if outcome.status != "ok":
        return outcome
    # Infinite may be the answer, as for a KL with p = 0 somewhere; nan is none.
    bad = [f"{r.metric} is nan" for r in outcome.records if math.isnan(r.value)]
    for name, image in outcome.images.items():
        count = int((~np.isfinite(image)).sum())
        if count:
            bad.append(f"image {name}: {count} of {image.size} values are not finite")
    if bad:
        outcome.status, outcome.reason = "nonfinite", ", ".join(bad)
    return outcome


def _caught(work: Callable[[], Any]) -> Any:
    """The result of ``work``, or the outcome that stands for its failure."""
    try:
        return work()
    except Unsupported as error:
        return Outcome("unsupported", _reason(error))
    except BudgetExceeded as error:
        return Outcome("timeout", _reason(error), traceback=traceback.format_exc())
    except FloatingPointError as error:
        return Outcome("nonfinite", _reason(error), traceback=traceback.format_exc())
    except (BadAdapter, InputError) as error:
        return Outcome("error", _reason(error), traceback=traceback.format_exc())
    except (Exception, SystemExit) as error:
        return Outcome("error", registry.oneline(error), traceback=traceback.format_exc())


def _reason(error: BaseException) -> str:
    """First line of the message."""
    return str(error).strip().partition("\n")[0] or type(error).__name__


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
