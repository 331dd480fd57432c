"""The mean of a few dozen independent values whose upper tail may be heavy, as over conditions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from harness.stats import tails
from harness.stats.intervals import Interval, mean_interval
from harness.stats.log_estimate import Seed
from harness.stats.variance import WIDEST, Deviations, lower_bound, tail_interval

LIGHT = 0.3
"""Of sixty values an index is known to a fifth or so: 1/2 would call many heavy tails light."""
PRIOR = (0.45, 0.25)
"""Of the index: some twenty values alone allow any, one without a mean too."""
_SHARE = 0.34
"""Of the values, those that are the tail; of few values a fifth is too few to fit."""


@dataclass(frozen=True)
class SkewedMean:
    """``interval`` of 95 %; not resolved, its upper end is infinite."""

    interval: Interval
    tail: tails.Class
    k: float = math.nan


def skewed_mean(x: ArrayLike, seed: Seed = 0) -> SkewedMean:
    """Mean of independent values [n] with the class of their tail.

    Light: :func:`mean_interval`. Heavy: that, widened to what a generalised Pareto tail may have.
    Not resolved: a lower bound alone.
    """
    x = np.asarray(x, float).ravel()
    plain = mean_interval(x, seed)
    if not (math.isfinite(plain.value) and plain.low > 0) or plain.low == plain.high:
        return SkewedMean(plain, "not diagnosed")
    keep = max(tails.tail_size(len(x)), int(_SHARE * len(x)) if len(x) < 600 else 0)
    if keep < tails.FEWEST:
        return SkewedMean(plain, "not diagnosed")
    d = np.sort(x - x.mean()) * (len(x) / (len(x) - 1))
    error = float(x.std(ddof=1) / math.sqrt(len(x)))
    kept = Deviations(d[-keep - 1 :], float(np.square(d).sum()), len(x), error, len(x) - 1.0)
    k = tails.index(tails.Excesses.of(kept.largest, len(x)).values)
    if k < LIGHT:
        return SkewedMean(plain, "light", k)
    wide = tail_interval(plain.value, kept, PRIOR).interval
    low, high = min(plain.low, wide.low), max(plain.high, wide.high)
    if high <= WIDEST * low:
        return SkewedMean(Interval(plain.value, low, high), "heavy", k)
    low = min(low, lower_bound(plain.value, kept).interval.low)
    return SkewedMean(Interval(plain.value, low, math.inf), "not resolved", k)
