"""Error at equal time: seconds per sample in interleaved rounds, then a race to a deadline."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from harness.core.protocol.errors import BudgetExceeded
from harness.core.record import Record
from harness.measures.base import Job, Measure, Outcome
from harness.measures.deadline_render import Runner, race
from harness.measures.images import checked, too_slow
from harness.measures.renders import Entrant, RenderSettings, enter
from harness.measures.timing import Timings, interleave
from harness.stats.intervals import mean_interval, ratio_of_means, speed_up


class EqualTime(Measure):
    """Seconds per sample per pixel, and what quality the same time buys.

    After a warm-up that lasts until two renders in a row take the same time, every method
    renders for about ``slice_seconds`` in each round, see
    :func:`~harness.measures.timing.interleave`. Then each renders in chunks for ``deadline``
    seconds, in turn with the others. ``disturbed`` is 1 where an interval of the times stayed
    wider than ``tolerance``; ``deadline-missed`` is 1 where ``deadline-miss``, the achieved
    time over the deadline less one, is more than half of ``agreement`` off, so that the
    achieved times of those not marked agree within ``agreement``.

    ``speedup-equal-time`` is (variance x seconds per sample) of the baseline over that of
    the method: how much longer the baseline runs for equal quality. Times are compared
    within their round (``time-ratio``). All times are wall-clock of finished renders: tracing
    rays, evaluating the material, sampling.
    """

    name = "equal-time"
    timed = True

    class Settings(RenderSettings):
        """See :class:`RenderSettings`."""

        deadline: float = 1.0
        agreement: float = 0.03

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
        base = next((i for i, job in enumerate(jobs) if job.baseline), None)
        if base is None:
            raise BudgetExceeded("the baseline is too slow for its rounds")
        entrants = [enter(job, settings, notify) for job in jobs]
        contenders = [e.contender(None if i == base else base) for i, e in enumerate(entrants)]
        timings = interleave(contenders, settings, notify)
        notify(f"{settings.deadline:g} s each, {len(entrants)} methods")
        runners = [
            _runner(entrant, timings.median(i).value, settings.deadline)
            for i, entrant in enumerate(entrants)
        ]
        race(runners)
        return [
            self._finish(i, entrants, base, timings, runner, settings)
            for i, runner in enumerate(runners)
        ]

    def _finish(
        self,
        index: int,
        entrants: Sequence[Entrant],
        base: int,
        timings: Timings,
        runner: Runner,
        settings: Settings,
    ) -> Outcome:
        entrant, rival = entrants[index], entrants[base]
        per_spp = timings.median(index)
        pixels = entrant.prepared.mask.size
        variance = np.array(entrant.errors)
        missed = abs(runner.miss) > settings.agreement / 2
        disturbed, reason = timings.mark(index)
        if missed:
            late = f"{settings.deadline:g} s missed by {runner.miss:+.1%}"
            reason = f"{reason}; {late}" if reason else late
        records = [
            Record("seconds-per-spp", *per_spp, "s"),
            Record("samples-per-second", pixels / per_spp.value, unit="1/s"),
            Record("time-ratio", *timings.ratio(index), "1"),
            Record("deadline-seconds", settings.deadline, unit="s"),
            Record("achieved-seconds", runner.seconds, unit="s"),
            Record("deadline-miss", runner.miss, unit="1"),
            Record("deadline-missed", float(missed), unit="1"),
            Record("spp-achieved", float(runner.spp), unit="1"),
            Record("mse-at-deadline", *mean_interval(variance / runner.spp), "radiance^2"),
            disturbed,
        ]
        seconds = timings.rival_seconds(index), timings.seconds(index)
        equal_time, equal_spp = (
            # By definition, not measurement: the baseline against itself.
            ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
            if index == base
            else compare((rival.errors, entrant.errors), seconds)
        )
        records.append(Record("speedup-equal-time", *equal_time, "1"))
        records.append(Record("speedup-equal-spp", *equal_spp, "1"))
        arrays = {
            "seconds": timings.seconds(index),
            "baseline_seconds": timings.rival_seconds(index),
            "batch_variance": variance,
            "baseline_variance": np.array(rival.errors),
            "round_spp": np.array(entrant.spp),
            "chunk_spp": np.array([spp for spp, _ in runner.chunks]),
            "chunk_seconds": np.array([seconds for _, seconds in runner.chunks]),
            "loadavg": timings.loadavg,
            "mask": entrant.prepared.mask,
        }
        return Outcome(
            reason=reason, records=records, arrays=arrays, images={"equal_time": runner.image}
        )


def compare(
    variance: tuple[ArrayLike, ArrayLike], seconds: tuple[ArrayLike, ArrayLike]
) -> tuple[Iterable[float], Iterable[float]]:
    """Speed-up over the baseline at equal time and at equal samples, each with its interval.

    Each pair is (baseline, method): ``variance`` of independent renders, ``seconds`` of the
    same rounds.
    """
    base, method = (np.asarray(v, float) for v in variance)
    resolved = bool((base > 0).all()), bool((method > 0).all())
    if not all(resolved):
        # An exact sampler has no variance, or one below the moments' rounding: a ratio with
        # it is infinite or nothing, or without meaning where both are exact.
        ratio = {(True, False): math.inf, (False, True): 0.0}.get(resolved, math.nan)
        return (ratio, math.nan, math.nan), (ratio, math.nan, math.nan)
    return speed_up(base, method, *seconds), ratio_of_means(base, method)


def _runner(entrant: Entrant, per_spp: float, deadline: float) -> Runner:
    """In the race: seeds that no round has used."""
    job, render = entrant.job, entrant.prepared.render
    return Runner(
        lambda spp, seed: checked(render(spp, seed), job),
        per_spp,
        deadline,
        900_000 + 7919 * job.seed,
    )
