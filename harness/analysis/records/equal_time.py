"""Seconds per sample per pixel, error at a deadline, and speed-up over the baseline."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from harness.analysis.disturbed import mark
from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval, ratio_of_means, speed_up
from harness.stats.round_times import RoundTimes

Triple = Iterable[float]


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.equal_time.EqualTime`."""
    seconds, base_seconds = raw.floats("seconds"), raw.floats("baseline_seconds")
    variance = raw.floats("batch_variance")
    compared = bool(raw.arrays["compared"])
    times = RoundTimes("render", seconds, base_seconds if compared else None)
    deadline = float(raw.settings["deadline"])
    achieved = float(raw.floats("chunk_seconds").sum())
    spp = int(raw.arrays["chunk_spp"].sum())
    miss = achieved / deadline - 1
    missed = abs(miss) > float(raw.settings["agreement"]) / 2
    disturbed, reason = mark([times], float(raw.settings["tolerance"]))
    late = f"{deadline:g} s missed by {miss:+.1%}" if missed else ""
    per_spp = times.median()
    # By definition, not measurement: the baseline against itself.
    equal_time: Triple = (1.0, 1.0, 1.0)
    equal_spp: Triple = (1.0, 1.0, 1.0)
    if compared:
        base_variance = raw.floats("baseline_variance")
        equal_time, equal_spp = compare((base_variance, variance), (base_seconds, seconds))
    records = [
        Record("seconds-per-spp", *per_spp, "s"),
        Record("samples-per-second", raw.arrays["mask"].size / per_spp.value, unit="1/s"),
        Record("time-ratio", *times.ratio(), "1"),
        Record("deadline-seconds", deadline, unit="s"),
        Record("achieved-seconds", achieved, unit="s"),
        Record("deadline-miss", miss, unit="1"),
        Record("deadline-missed", float(missed), unit="1"),
        Record("spp-achieved", float(spp), unit="1"),
        Record("mse-at-deadline", *mean_interval(variance / spp), "radiance^2"),
        disturbed,
        Record("speedup-equal-time", *equal_time, "1"),
        Record("speedup-equal-spp", *equal_spp, "1"),
    ]
    return Numbers(records, "; ".join(filter(None, [reason, late])))


def compare(
    variance: tuple[ArrayLike, ArrayLike], seconds: tuple[ArrayLike, ArrayLike]
) -> tuple[Triple, Triple]:
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
