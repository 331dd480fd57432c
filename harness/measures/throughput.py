"""Samples and pdf queries per second, without a renderer around them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field

from harness.measures.base import Job, Measure, Outcome
from harness.measures.compact import single
from harness.measures.timing import (
    Contender,
    RoundSettings,
    Timings,
    interleave,
    seconds_of,
    settle,
)


class BatchSettings(RoundSettings):
    """``batch`` rows, as a renderer's wavefront has them, or as many as ``max_seconds`` allow;
    ``rows``, where given, are exactly so many instead.

    A round has ``slices`` slices of one call or more, so many that together they take
    ``least_seconds``; each has one of the baseline's beside it (:class:`Contender`). A clock reads
    milliseconds well, a machine does not keep quiet for them.

    ``processes`` repeats the timing in so many fresh processes, one after the other; in up to
    ``max_processes`` (default: no more) while an interval is wider than ``tolerance``. The numbers
    are means over them, with intervals that say how one more would differ
    (:mod:`harness.analysis.process_pooling`).
    """

    processes: int = 1
    max_processes: int | None = None
    batch: int = 262_144
    rows: int | None = None
    rounds: int = 11
    max_seconds: float = 1.0
    least_seconds: float = 0.05
    slices: Annotated[int, Field(ge=1)] = 5


class Throughput(Measure):
    """Rows per second of ``sample`` and ``pdf`` on one batch of random conditions.

    Each call is warmed up until two in a row agree within ``stable``; then the methods are timed in
    interleaved rounds, each beside the baseline: :func:`~harness.measures.timing.interleave`. The
    batch is in memory before the clock starts, and the result is there when it stops. A method too
    slow for the whole batch within ``max_seconds`` is timed on a part of it, and the ``batch``
    record says so.
    ``sample-time-ratio`` and ``pdf-time-ratio`` are times per row over the baseline's of the
    same round. ``disturbed`` is 1 where an interval stayed wider than ``tolerance``.
    """

    name = "throughput"
    needs_scene = False
    timed = True

    class Settings(BatchSettings):
        """See :class:`BatchSettings`."""

    @classmethod
    def later_processes(cls, first: Outcome) -> dict[str, Any]:
        """See :class:`Measure`."""
        return rows_of(first)

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        batches = [prepare_batch(job, self.Settings(**job.settings), notify) for job in jobs]
        base = next((2 * j for j, job in enumerate(jobs) if job.baseline), None)
        contenders = [
            entry
            for job, batch in zip(jobs, batches, strict=True)
            for entry in batch.contenders(job, None if job.baseline else base)
        ]
        timings = interleave(contenders, settings, notify)
        return [
            Outcome(arrays=times_of_calls(timings, 2 * j, batch)) for j, batch in enumerate(batches)
        ]


@dataclass(frozen=True)
class Repeated:
    """A call on ``rows`` rows, ``times`` times in a row; warmed up."""

    call: Callable[[], object]
    rows: int
    times: int

    def __call__(self) -> None:
        """All of them."""
        for _ in range(self.times):
            self.call()


@dataclass(frozen=True)
class Batch:
    """``sample`` and ``pdf`` of one method on ``rows`` rows, warmed up."""

    sample: Repeated
    pdf: Repeated
    slices: int

    @property
    def rows(self) -> int:
        """Of a single call."""
        return self.sample.rows

    def contenders(self, job: Job, first_rival: int | None) -> list[Contender]:
        """Sample and pdf, in seconds per row; their rivals are two in a row."""
        device, name = job.budget.device, job.method.name
        rivals = (None, None) if first_rival is None else (first_rival, first_rival + 1)
        return [
            Contender(
                f"{name} {what}",
                lambda _, work=work: seconds_of(work, device),
                work.rows * work.times,
                rival,
                self.slices,
            )
            for what, work, rival in zip(
                ("sample", "pdf"), (self.sample, self.pdf), rivals, strict=True
            )
        ]


def rows_of(outcome: Outcome) -> dict[str, Any]:
    """Settings with which a call has as many rows as it had in ``outcome``."""
    batch = outcome.arrays.get("batch")
    return {} if batch is None else {"rows": int(batch)}


def prepare_batch(job: Job, settings: BatchSettings, notify: Callable[[str], None]) -> Batch:
    """Warm ``sample`` and ``pdf`` up, on as many rows as the settings allow."""
    notify(f"{job.method.name}: warm-up")
    device, rows = job.budget.device, settings.rows or 1
    while True:
        sample, pdf = _calls(job, rows)
        seconds = settle(lambda call=sample: seconds_of(call, device), settings)
        fits = settings.max_seconds / seconds * rows
        if rows in (settings.rows, settings.batch) or fits < 2 * rows:
            break
        rows = int(min(settings.batch, fits, 64 * rows))
    once = {sample: seconds, pdf: settle(lambda: seconds_of(pdf, device), settings)}
    least = settings.least_seconds / settings.slices
    calls = (Repeated(call, rows, max(1, math.ceil(least / once[call]))) for call in once)
    return Batch(*calls, settings.slices)


def _calls(job: Job, rows: int) -> tuple[Callable[[], object], Callable[[], object]]:
    method, device = job.method, job.budget.device
    condition = job.material.conditions(rows, job.generator, device)
    u = torch.rand(rows, 3, generator=job.generator).to(device)
    with torch.inference_mode():
        wo = method.sample(condition, u).wo
    return lambda: method.sample(condition, u), lambda: method.pdf(condition, wo)


def times_of_calls(timings: Timings, first: int, batch: Batch) -> dict[str, np.ndarray]:
    """Raw arrays of ``sample`` and ``pdf``, contenders ``first`` and the next.

    Seconds of one call of the batch in each round, and the baseline's per row in the same rounds.
    """
    arrays = {"batch": np.array(batch.rows)}
    for index, what in ((first, "sample"), (first + 1, "pdf")):
        arrays[f"{what}_seconds"] = single(timings.seconds(index) * batch.rows)
        arrays[f"baseline_{what}_seconds_per_row"] = single(timings.rival_seconds(index))
    arrays["compared"] = np.array(timings.contenders[first].rival is not None)
    arrays["loadavg"] = timings.loadavg
    return arrays
