"""Timings over several processes: what is the same in all rounds of one is another in the next.

Where memory comes to lie differs from process to process by per cents, and an interval over
the rounds of one cannot know it. With ``sittings`` (see
:class:`~harness.measures.throughput.BatchSettings`) the whole measure is run that often, each time
in a fresh process, and :func:`harness.analysis.process_pooling.pooled` makes one outcome of them.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection

import torch

from harness.analysis.process_pooling import disturbed, pooled
from harness.core.protocol.errors import BudgetExceeded, Unsupported
from harness.core.registry import oneline
from harness.measures import registry as measures
from harness.measures.base import Measure, Outcome
from harness.runner.jobs import Jobs
from harness.runner.preflight import ready
from harness.store.stored import Stored
from harness.suite.trials import Trial, stream_seed

_KNOWN = {kind.__name__: kind for kind in (Unsupported, BudgetExceeded, FloatingPointError)}
"""Exceptions that give a trial a status of its own."""
_APART = 1000
"""Between the seeds of two sittings, so that none repeats another's random numbers."""


def count(measure: Measure, trial: Trial) -> tuple[int, int]:
    """In how many processes ``trial`` is to be timed, at least and at most.

    1 and 1 for a measure that knows no sittings.
    """
    settings = measure.Settings(**trial.settings)
    least = getattr(settings, "sittings", 1)
    return least, max(least, getattr(settings, "max_sittings", None) or least)


@dataclass(frozen=True)
class _Asked:
    """What a sitting needs to make its own jobs."""

    trials: list[Trial]
    baseline: str
    stored: dict[str, Stored]
    number: int


def run(
    measure: Measure, trials: list[Trial], jobs: Jobs, note: Callable[[str], None]
) -> list[Outcome]:
    """One outcome for each of ``trials`` [T], pooled over the sittings.

    Raises:
        Unsupported, BudgetExceeded, FloatingPointError: as the measure raised it in a sitting.
        RuntimeError: a sitting failed otherwise, or ended without an answer.
    """
    needed = {trial.fit: jobs.stored[trial.fit] for trial in trials}
    least, most = count(measure, trials[0])
    tolerance = measure.Settings(**trials[0].settings).tolerance
    asked = trials
    found: list[list[Outcome]] = []
    together: list[Outcome] = []
    while len(found) < least or (len(found) < most and any(map(disturbed, together))):
        number, total = len(found), least if len(found) < least else most
        found.append(
            _sitting(
                _Asked(asked, jobs.baseline, needed, number),
                lambda text, n=number + 1, of=total: note(f"sitting {n} of {of}: {text}"),
            )
        )
        if number == 0:
            asked = [
                replace(t, settings={**t.settings, **measure.later_sittings(first)})
                for t, first in zip(trials, found[0], strict=True)
            ]
        together = [
            pooled(outcomes, tolerance, measure.own_times) for outcomes in zip(*found, strict=True)
        ]
    return together


def _sitting(asked: _Asked, note: Callable[[str], None]) -> list[Outcome]:
    context = get_context("spawn")  # a fork would share the memory whose place is to vary
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_sit, args=(there, asked))
    process.start()
    there.close()
    try:
        while True:
            kind, said = here.recv()
            if kind == "done":
                return said
            if kind == "failed":
                name, message = said
                raise _KNOWN.get(name, RuntimeError)(f"in a sitting: {message}")
            note(said)
    except EOFError:
        process.join()
        raise RuntimeError(f"a sitting ended with exit status {process.exitcode}") from None
    finally:
        process.terminate()
        process.join()


def _sit(parent: Connection, asked: _Asked) -> None:
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
