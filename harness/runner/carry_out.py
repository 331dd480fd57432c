"""Carries out tasks in this process, whichever it is. Work that fails gives its reason.

A measure that fails for several methods together is run for each alone with the baseline, to find
out which of them it was.
"""

from __future__ import annotations

import math
import os
import platform
import time
import traceback
from collections.abc import Callable
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch

from harness.core import machine, registry
from harness.core.protocol.errors import BudgetExceeded, InputError, Unsupported
from harness.identity.ours import digests
from harness.measures import registry as measures
from harness.measures.adapter_smoke_test import BadAdapter
from harness.measures.base import Job, Outcome
from harness.runner import global_state, machine_lock, process_repeats
from harness.runner.jobs import Jobs
from harness.runner.probing import Prober
from harness.runner.task import CHECK, PROBE, Answer, Task
from harness.suite.resolve import Resolved
from harness.suite.trials import Trial, stream_seed

FIT_THREADS = 1
"""Threads of torch in a fit: sums over threads round differently, and fits may run side by side."""


class Carrier:
    """Does one task after the other, and keeps what they share: materials, scenes, methods."""

    def __init__(self, note: Callable[[str], None], resolved: Resolved | None = None):
        global_state.settle()
        self.note = note
        self.jobs = Jobs("", {}, note, resolved)
        self.prober: Prober | None = None
        self.material = ""
        self.threads = torch.get_num_threads()
        self.seen: global_state.GlobalState | None = None

    def do(self, task: Task, begun: Callable[[], None] = lambda: None) -> Answer:
        """The answer to ``task``; ``begun`` is called once the machine is free for it."""
        if task.first.material != self.material:
            self.jobs.forget_methods()
            self.jobs.stored.clear()
            self.material = task.first.material
        self.jobs.baseline = task.baseline
        self.jobs.stored.update(task.fits)
        held = nullcontext()
        if task.kind not in (PROBE, CHECK):
            held = machine_lock.machine(self.note, alone=task.alone)
        with held:
            begun()
            torch.set_num_threads(FIT_THREADS if task.is_fit else self.threads)
            global_state.seed_all(stream_seed(task.first.measure, task.first.seed))
            before = global_state.look(self.seen)
            try:
                answer = self._answer(task)
                self.seen = global_state.look()
            finally:
                torch.set_num_threads(self.threads)
            if task.kind != PROBE:  # which seeds and traces torch by itself
                answer.findings = global_state.changes(before, self.seen)
            return answer

    def _answer(self, task: Task) -> Answer:
        if task.kind == CHECK:
            return Answer(refused=_refusal(task.first))
        if task.kind == PROBE:
            return self._probe(task)
        started, clock = _utc(), time.perf_counter()
        environment = machine.describe(task.first.budget.device)
        environment["machine"]["host"] = platform.node()
        if spent := machine.kernel_seconds():
            environment["kernel_seconds"] = spent
        if task.alone:
            environment["load"] = [round(load, 2) for load in os.getloadavg()]
            environment["clock"] = _clock()
        outcomes = self._outcomes(list(task.trials))
        return Answer(
            outcomes,
            {t.hash: self.jobs.choices[t.hash] for t in task.trials if t.hash in self.jobs.choices},
            environment=environment,
            started=started,
            seconds=(time.perf_counter() - clock) / len(outcomes),
        )

    def _probe(self, task: Task) -> Answer:
        """Of one part, or why it cannot be had: what cannot be compared is measured again."""
        if self.prober is None:
            self.prober = Prober(self.jobs, digests())
        try:
            found = self.prober.probe(task.first, task.part, dict(task.begins), task.timed)
            return Answer(probe=found.packed())
        except Exception as error:
            return Answer(refused=registry.oneline(error))

    def _outcomes(self, trials: list[Trial]) -> list[Outcome]:
        jobs: list[Job | Outcome] = [_caught(lambda t=t: self.jobs.make(t)) for t in trials]
        for trial, job in zip(trials, jobs, strict=True):
            if trial.timed and trial.method == self.jobs.baseline and isinstance(job, Outcome):
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
            outcomes = process_repeats.run(measure, trials, self.jobs, self.note)
        else:
            torch.manual_seed(stream_seed(first.measure, first.seed))
            outcomes = measure.run(jobs, self.note)
        if len(outcomes) != len(jobs):
            raise RuntimeError(f"{measure.name}: {len(outcomes)} outcomes for {len(jobs)} jobs")
        for job, outcome in zip(jobs, outcomes, strict=True):
            number(job.trial, outcome)
        return [finished(outcome) for outcome in outcomes]

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


def number(trial: Trial, outcome: Outcome) -> None:
    """Give an outcome the records that the analysis makes of its raw data."""
    made = process_repeats.numbers_of(trial.measure, trial.settings, outcome)
    outcome.records, outcome.reason = made.records, made.reason


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


def _refusal(trial: Trial) -> str:
    """Why the method of ``trial`` cannot be constructed; "" if it can."""
    try:
        registry.make(trial.method_name, **trial.params)
    except Exception as error:
        text = str(error) if isinstance(error, InputError) else registry.oneline(error)
        return text.strip().partition("\n")[0]
    return ""


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


def _clock() -> list[float]:
    """MHz of every core, where the system tells."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.is_file() else []
    return [round(float(x.partition(":")[2])) for x in lines if x.lower().startswith("cpu mhz")]
