"""Timings over several processes: what is the same in all rounds of one is another in the next.

Where memory comes to lie differs from process to process by per cents, and an interval over
the rounds of one cannot know it. With ``processes`` (see
:class:`~harness.measures.throughput.BatchSettings`) the whole measure is run that often, each time
in a fresh process; the raw data of all are kept, and :mod:`harness.analysis.process_pooling` pools
their numbers.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import torch

from harness.analysis.process_pooling import disturbed, pooled, together
from harness.analysis.records import registry as records
from harness.core.protocol.errors import BudgetExceeded, Unsupported
from harness.core.record import Numbers, Raw
from harness.core.registry import oneline
from harness.measures import registry as measures
from harness.measures.base import Measure, Outcome
from harness.runner.jobs import Jobs
from harness.runner.preflight import ready
from harness.runner.task import Fitted
from harness.suite.trials import Trial, stream_seed

_KNOWN = {kind.__name__: kind for kind in (Unsupported, BudgetExceeded, FloatingPointError)}
"""Exceptions that give a trial a status of its own."""
_APART = 1000
"""Between the seeds of two processes, so that none repeats another's random numbers."""


def count(measure: Measure, trial: Trial) -> tuple[int, int]:
    """In how many processes ``trial`` is to be timed, at least and at most.

    1 and 1 for a measure that is not repeated in fresh processes.
    """
    settings = measure.Settings(**trial.settings)
    least = getattr(settings, "processes", 1)
    return least, max(least, getattr(settings, "max_processes", None) or least)


@dataclass(frozen=True)
class _Asked:
    """What a process needs to make its own jobs."""

    trials: list[Trial]
    baseline: str
    stored: dict[str, Fitted]
    number: int


def run(
    measure: Measure, trials: list[Trial], jobs: Jobs, note: Callable[[str], None]
) -> list[Outcome]:
    """One outcome for each of ``trials`` [T], with the raw data of all processes.

    Raises:
        Unsupported, BudgetExceeded, FloatingPointError: as the measure raised it in a process.
        RuntimeError: a process failed otherwise, or ended without an answer.
    """
    needed = {trial.fit: jobs.stored[trial.fit] for trial in trials}
    least, most = count(measure, trials[0])
    tolerance = measure.Settings(**trials[0].settings).tolerance
    asked = trials
    found: list[list[Outcome]] = []
    all_together: list[Outcome] = []

    def wide() -> bool:
        pairs = zip(trials, all_together, strict=True)
        return any(disturbed(numbers_of(measure.name, t.settings, one)) for t, one in pairs)

    while len(found) < least or (len(found) < most and wide()):
        number, total = len(found), least if len(found) < least else most
        found.append(
            _in_process(
                _Asked(asked, jobs.baseline, needed, number),
                lambda text, n=number + 1, of=total: note(f"process {n} of {of}: {text}"),
            )
        )
        if number == 0:
            asked = [
                replace(t, settings={**t.settings, **measure.later_processes(first)})
                for t, first in zip(trials, found[0], strict=True)
            ]
        all_together = [_joined(outcomes, tolerance) for outcomes in zip(*found, strict=True)]
    return all_together


def numbers_of(measure: str, settings: dict[str, Any], outcome: Outcome) -> Numbers:
    """The records of an outcome that is a success; none of another."""
    if outcome.status != "ok":
        return Numbers([], outcome.reason)
    made = records.numbers(measure, Raw(outcome.arrays, outcome.documents, settings))
    return Numbers(outcome.records, outcome.reason) if made is None else made


def _joined(outcomes: Sequence[Outcome], tolerance: float) -> Outcome:
    """One outcome with all raw data; one that is not a success stands for all."""
    for outcome in outcomes:
        if outcome.status != "ok":
            return outcome
    own = [Numbers(outcome.records, outcome.reason) for outcome in outcomes if outcome.records]
    made = pooled(own, tolerance) if own else Numbers([])
    return Outcome(
        reason=made.reason,
        arrays=together([outcome.arrays for outcome in outcomes]),
        documents=together([outcome.documents for outcome in outcomes]),
        records=made.records,
    )


def _in_process(asked: _Asked, note: Callable[[str], None]) -> list[Outcome]:
    context = get_context("spawn")  # a fork would share the memory whose place is to vary
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(there, asked))
    process.start()
    there.close()
    try:
        while True:
            kind, said = here.recv()
            if kind == "done":
                return said
            if kind == "failed":
                name, message = said
                raise _KNOWN.get(name, RuntimeError)(f"in a fresh process: {message}")
            note(said)
    except EOFError:
        process.join()
        raise RuntimeError(f"a process ended with exit status {process.exitcode}") from None
    finally:
        process.terminate()
        process.join()


def _work(parent: Connection, asked: _Asked) -> None:
    """In the process: the measure, once."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent, which ends this one

    def note(text: str) -> None:
        parent.send(("note", text))

    try:
        first = asked.trials[0]
        ready(first.budget.device)
        apart = _APART * asked.number
        torch.manual_seed(stream_seed(first.measure, first.seed + apart))
        make = Jobs(asked.baseline, asked.stored, note).make
        jobs = [make(replace(trial, seed=trial.seed + apart)) for trial in asked.trials]
        parent.send(("done", measures.make(first.measure).run(jobs, note)))
    except BaseException as error:
        name = type(error).__name__
        parent.send(("failed", (name, str(error) if name in _KNOWN else oneline(error))))
