"""Samples and pdf queries per second, without a renderer around them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from harness.measures.base import Job, Measure, Outcome, Record
from harness.measures.base import Settings as BaseSettings
from harness.protocol import Method
from harness.stats.intervals import median_interval


class Throughput(Measure):
    """Rows per second of ``sample`` and ``pdf`` on one batch of random conditions.

    Each call is warmed up until two in a row agree within ``stable``; then methods take
    turns for ``rounds`` rounds. The batch is in memory before the clock starts, and the
    result is there when it stops. A method too slow for the whole batch within
    ``max_seconds`` is timed on a part of it, and the ``batch`` record says so.
    """

    name = "throughput"
    needs_scene = False
    timed = True

    class Settings(BaseSettings):
        """``batch`` rows, as a renderer's wavefront has them."""

        batch: int = 262_144
        rounds: int = 11
        stable: float = 0.1
        max_seconds: float = 1.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        calls = []
        for job in jobs:
            notify(f"{job.method.name}: warm-up")
            calls.append(_prepare(job, settings))
        times: list[list[list[float]]] = [[[], []] for _ in jobs]
        for number in range(settings.rounds):
            notify(f"throughput round {number + 1} of {settings.rounds}")
            for j in [*range(number % len(jobs), len(jobs)), *range(number % len(jobs))]:
                for kind in (0, 1):
                    times[j][kind].append(_timed(calls[j][kind], jobs[j].budget.device))
        return [_outcome(*pair, rows) for pair, (_, _, rows) in zip(times, calls, strict=True)]


def _prepare(job: Job, settings: Throughput.Settings) -> tuple[Callable, Callable, int]:
    """Warm ``sample`` and ``pdf`` calls, and how many rows they take."""
    device, method = job.budget.device, job.method
    rows = 1
    while True:
        sample, pdf = _calls(job, method, rows, device)
        seconds = _warm(sample, settings, device)
        fits = settings.max_seconds / seconds * rows
        if rows == settings.batch or fits < 2 * rows:
            break
        rows = int(min(settings.batch, fits, 64 * rows))
    _warm(pdf, settings, device)
    return sample, pdf, rows


def _calls(job: Job, method: Method, rows: int, device: str) -> tuple[Callable, Callable]:
    condition = job.material.conditions(rows, job.generator, device)
    u = torch.rand(rows, 3, generator=job.generator).to(device)
    with torch.inference_mode():
        wo = method.sample(condition, u).wo
    return lambda: method.sample(condition, u), lambda: method.pdf(condition, wo)


def _warm(call: Callable, settings: Throughput.Settings, device: str) -> float:
    last = np.inf
    for _ in range(20):
        now = _timed(call, device)
        if abs(now - last) < settings.stable * last:
            break
        last = now
    return now


def _timed(call: Callable, device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize(device)
    start = time.perf_counter()
    with torch.inference_mode():
        call()
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start


def _outcome(sample: list[float], pdf: list[float], rows: int) -> Outcome:
    records = [Record("batch", float(rows), unit="1")]
    for metric, seconds in (("samples-per-second", sample), ("pdf-queries-per-second", pdf)):
        value, low, high = median_interval(seconds)
        records.append(Record(metric, rows / value, rows / high, rows / low, "1/s"))
    arrays = {"sample_seconds": np.array(sample), "pdf_seconds": np.array(pdf)}
    return Outcome(records=records, arrays=arrays)
