"""Error at equal time: seconds per sample in interleaved rounds, then a race to a deadline."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from harness.measures.base import Job, Measure, Outcome, Record
from harness.measures.base import Settings as BaseSettings
from harness.measures.images import checked, too_slow
from harness.protocol import BudgetExceeded
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared, prepare
from harness.stats.intervals import mean_interval, median_interval, ratio_of_means, speed_up


@dataclass
class _Runner:
    """One method in the race."""

    job: Job
    prepared: Prepared
    spp: int = 2
    seconds: list[float] = field(default_factory=list)
    passes: list[Pass] = field(default_factory=list)

    @property
    def variance(self) -> np.ndarray:
        """Per round: the variance of one sample, averaged over the pixels that count."""
        return np.array([p.variance[self.prepared.mask].mean() for p in self.passes])


class EqualTime(Measure):
    """Seconds per sample per pixel, and what quality the same time buys.

    After a warm-up that lasts until two renders in a row take the same time within
    ``stable`` (or ``warm_up`` seconds have gone), ``rounds`` rounds let every method render
    for about ``slice_seconds``, in an order that rotates from round to round, so that drift
    of the machine hits all alike. Then each renders in chunks for ``deadline`` seconds.

    ``speedup-equal-time`` is (variance x seconds per sample) of the baseline over that of
    the method: how much longer the baseline runs for equal quality. Times are compared
    within their round. All times are wall-clock of finished renders: tracing rays,
    evaluating the material, sampling.
    """

    name = "equal-time"
    timed = True

    class Settings(BaseSettings):
        """``slice_seconds`` per method and round.

        A method that would need more than ``patience`` seconds for its rounds is not begun.
        """

        rounds: int = 12
        slice_seconds: float = 0.2
        deadline: float = 1.0
        resolution: int = 96
        warm_up: float = 3.0
        stable: float = 0.1
        patience: float = 3600.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        slow = [
            too_slow(j, settings.resolution, 2 * settings.rounds, settings.patience) for j in jobs
        ]
        fit = [job for job, reason in zip(jobs, slow, strict=True) if not reason]
        found = iter(self._timed(fit, settings, notify))
        return [Outcome("timeout", reason) if reason else next(found) for reason in slow]

    def _timed(
        self, jobs: list[Job], settings: Settings, notify: Callable[[str], None]
    ) -> list[Outcome]:
        runners = [
            _Runner(j, prepare(j.scene, j.material, j.method, settings.resolution)) for j in jobs
        ]
        base = next((r for r in runners if r.job.baseline), None)
        if base is None:
            raise BudgetExceeded("the baseline is too slow for its rounds")
        for runner in runners:
            notify(f"{runner.job.method.name}: warm-up")
            _warm_up(runner, settings)
        for number in range(settings.rounds):
            notify(f"timing round {number + 1} of {settings.rounds}, {len(runners)} methods")
            turn = number % len(runners)
            for runner in runners[turn:] + runners[:turn]:
                seed = 5000 * (runner.job.seed + 1) + number
                rendered = checked(runner.prepared.render(runner.spp, seed), runner.job)
                runner.seconds.append(rendered.seconds / runner.spp)
                runner.passes.append(rendered)
        return [self._finish(r, base, settings, notify) for r in runners]

    def _finish(
        self, runner: _Runner, base: _Runner, settings: Settings, notify: Callable[[str], None]
    ) -> Outcome:
        notify(f"{runner.job.method.name}: {settings.deadline:g} s")
        image, spp, seconds = _race(runner, settings.deadline)
        per_spp = median_interval(runner.seconds)
        pixels = settings.resolution**2
        mask = runner.prepared.mask
        error = mean_interval(runner.variance / spp)
        records = [
            Record("seconds-per-spp", *per_spp, "s"),
            Record("samples-per-second", pixels / per_spp.value, unit="1/s"),
            Record("deadline-seconds", settings.deadline, unit="s"),
            Record("achieved-seconds", seconds, unit="s"),
            Record("spp-achieved", float(spp), unit="1"),
            Record("mse-at-deadline", *error, "radiance^2"),
        ]
        equal_time, equal_spp = _compare(runner, base)
        records.append(Record("speedup-equal-time", *equal_time, "1"))
        records.append(Record("speedup-equal-spp", *equal_spp, "1"))
        arrays = {
            "seconds": np.array(runner.seconds),
            "baseline_seconds": np.array(base.seconds),
            "batch_variance": runner.variance,
            "baseline_variance": base.variance,
            "round_spp": np.array(runner.spp),
            "mask": mask,
        }
        return Outcome(records=records, arrays=arrays, images={"equal_time": image})


def _compare(runner: _Runner, base: _Runner) -> tuple[Iterable[float], Iterable[float]]:
    """Speed-up over the baseline at equal time and at equal samples, each with its interval."""
    if runner is base:
        # By definition, not measurement: the baseline against itself.
        return (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)
    resolved = [bool((r.variance > 0).all()) for r in (base, runner)]
    if not all(resolved):
        # An exact sampler has no variance, or one below the moments' rounding: a ratio with
        # it is infinite or nothing, or without meaning where both are exact.
        ratio = {(True, False): math.inf, (False, True): 0.0}.get(tuple(resolved), math.nan)
        return (ratio, math.nan, math.nan), (ratio, math.nan, math.nan)
    return (
        speed_up(base.variance, runner.variance, base.seconds, runner.seconds),
        ratio_of_means(base.variance, runner.variance),
    )


def _warm_up(runner: _Runner, settings: EqualTime.Settings) -> None:
    """Compile, fill caches, and find the samples that fill one slice."""
    start, last = time.perf_counter(), np.inf
    for attempt in range(100):
        rendered = checked(runner.prepared.render(runner.spp, seed=77 + attempt), runner.job)
        steady = abs(rendered.seconds - last) < settings.stable * last
        last = rendered.seconds
        wanted = int(settings.slice_seconds / (rendered.seconds / runner.spp))
        grow = wanted > 1.5 * runner.spp
        # At least two samples a pixel: one has no variance.
        runner.spp = max(2, min(wanted, 8 * runner.spp))
        if (steady and not grow) or time.perf_counter() - start > settings.warm_up:
            return


def _race(runner: _Runner, deadline: float) -> tuple[np.ndarray, int, float]:
    """Render chunks until the deadline: mean image, samples per pixel, seconds taken.

    Chunks are a tenth of the deadline, shrinking at its end; the last one is left out where
    even one sample per pixel would overrun it, but one chunk there always is.
    """
    per_spp = float(np.median(runner.seconds))
    total, spp, seed = 0.0, 0, 900_000 + 7919 * runner.job.seed
    start = time.perf_counter()
    while True:
        left = deadline - (time.perf_counter() - start)
        count = int(min(deadline / 10, left) / per_spp)
        if count < 1:
            if spp:
                break
            count = 1
        rendered = checked(runner.prepared.render(count, seed + spp), runner.job)
        total = total + rendered.rgb * count
        spp += count
    return total / spp, spp, time.perf_counter() - start
