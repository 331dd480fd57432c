"""Point values with confidence intervals. Every function says which kind of interval."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats.distributions import binomial_cdf, t_quantile
from harness.stats.log_estimate import (
    LogEstimate,
    Seed,
    log_mean,
    log_paired_ratio_of_means,
    log_ratio_of_medians,
)


class Interval(NamedTuple):
    """A value and its interval; the ends are nan where there are too few values for one."""

    value: float
    low: float
    high: float


def interval_of_draws(draws: NDArray) -> NDArray:
    """Ends [2, ...] of the central 95 % of draws [..., R] of a number, of any distribution.

    Their 2.5 and 97.5 percentiles, between the nearest two in proportion; nan where a draw is.
    """
    # Sorting takes a third of the time of numpy's selection.
    ordered = np.sort(draws, axis=-1)
    at = np.array([0.025, 0.975]) * (ordered.shape[-1] - 1)
    low = np.floor(at).astype(int)
    below, above = (np.moveaxis(ordered[..., i], -1, 0) for i in (low, np.ceil(at).astype(int)))
    share = (at - low).reshape(2, *[1] * (below.ndim - 1))
    with np.errstate(invalid="ignore"):  # between two that are infinite
        between = np.where(below == above, below, below + share * (above - below))
    # What is no number is sorted last.
    return np.where(np.isnan(ordered[..., -1]), np.nan, between)


def mean_interval(x: ArrayLike, seed: Seed = 0, level: float = 0.95) -> Interval:
    """Mean of independent values [B].

    Symmetric studentised bootstrap, on the log scale where all values are positive;
    Student's t for values of both signs, which have no scale to take logarithms of.
    An infinite value makes the mean infinite, and its interval too.
    """
    x = np.asarray(x, float).ravel()
    if not len(x):
        raise ValueError("no values")
    mean = float(x.mean())
    if not np.isfinite(mean):
        return Interval(mean, mean, mean)
    if (x > 0).all():
        return _interval(log_mean(x, seed), level)
    if len(x) < 2:
        return Interval(mean, float("nan"), float("nan"))
    half = t_quantile((1 + level) / 2, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x))
    return Interval(mean, mean - float(half), mean + float(half))


def median_interval(x: ArrayLike, level: float = 0.95) -> Interval:
    """Median of independent values [B], without assuming a distribution.

    Order statistics, interpolated between the two whose exact (binomial) levels enclose the
    wanted one (Hettmansperger and Sheather, 1986). Fewer than six values cannot reach 95 %:
    the ends are then the smallest and the largest, of level ``1 - 2^(1-n)``.
    """
    x = np.sort(np.asarray(x, float).ravel())
    n = len(x)
    if not n:
        raise ValueError("no values")
    middle = float(np.median(x))
    if n == 1:
        return Interval(middle, float("nan"), float("nan"))

    if _covered(1, n) <= level:
        return Interval(middle, float(x[0]), float(x[-1]))
    k = 1
    while k + 1 <= n // 2 and _covered(k + 1, n) >= level:
        k += 1
    inner = min(k + 1, (n + 1) // 2)
    wide, narrow = _covered(k, n), _covered(inner, n)
    if inner == k or wide == narrow:
        return Interval(middle, float(x[k - 1]), float(x[n - k]))
    share = (wide - level) / (wide - narrow)
    weight = (n - k) * share / (k + (n - 2 * k) * share)
    low = (1 - weight) * x[k - 1] + weight * x[inner - 1]
    high = (1 - weight) * x[n - k] + weight * x[n - inner]
    return Interval(middle, float(low), float(high))


@lru_cache(maxsize=1024)
def _covered(k: int, n: int) -> float:
    """Exact level of [k-th smallest, k-th largest] of n values, k from 1."""
    return 1 - 2 * float(binomial_cdf(k - 1, n, 0.5))


def ratio_of_means(
    a: ArrayLike, b: ArrayLike, *, paired: bool = False, seed: Seed = 0, level: float = 0.95
) -> Interval:
    """``mean(a) / mean(b)`` of positive values, with the bias of a ratio of means taken off.

    Symmetric studentised bootstrap of its log.

    ``paired``: ``a[i]`` and ``b[i]`` were taken together (interleaved rounds) and are
    resampled together; otherwise the two are independent and may differ in number.
    """
    rng = np.random.default_rng(seed)
    if paired:
        return _interval(log_paired_ratio_of_means(a, b, rng), level)
    # One generator for both: equal seeds would resample the two alike.
    return _interval(log_mean(a, rng) - log_mean(b, rng), level)


def ratio_of_medians(a: ArrayLike, b: ArrayLike, level: float = 0.95) -> Interval:
    """Median of the ratios ``a[i] / b[i]`` of paired rounds; interval of :func:`median_interval`.

    What slows a whole round hits both times and cancels.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        raise ValueError(f"rounds must be equally many, got {a.shape} and {b.shape}")
    return median_interval(a / b, level)


def speed_up(
    baseline_variance: ArrayLike,
    method_variance: ArrayLike,
    baseline_seconds: ArrayLike,
    method_seconds: ArrayLike,
    *,
    seed: Seed = 0,
    level: float = 0.95,
) -> Interval:
    """How many times longer the baseline runs for equal quality; see :func:`log_speed_up`.

    Symmetric studentised bootstrap of the log, over batches and over rounds at once.
    """
    estimate = log_speed_up(
        baseline_variance, method_variance, baseline_seconds, method_seconds, seed
    )
    return _interval(estimate, level)


def log_speed_up(
    baseline_variance: ArrayLike,
    method_variance: ArrayLike,
    baseline_seconds: ArrayLike,
    method_seconds: ArrayLike,
    seed: Seed = 0,
) -> LogEstimate:
    """Log of (variance x seconds per sample) of the baseline over that of the method.

    Variances [B] are of independent batches, independent between the two; seconds [rounds]
    are of interleaved rounds, paired between the two.
    """
    rng = np.random.default_rng(seed)
    error = log_mean(baseline_variance, rng) - log_mean(method_variance, rng)
    return error + log_ratio_of_medians(baseline_seconds, method_seconds, rng)


def geometric_mean(x: ArrayLike, level: float = 0.95) -> Interval:
    """Geometric mean of positive values, as a sample of more such: Student's t on the logs.

    The interval says how it would differ with *other* materials of the kind. How it would
    differ with new measurements on the same ones is :func:`geometric_mean_of`.
    """
    logs = np.log(_all_positive(x))
    middle = float(logs.mean())
    if len(logs) < 2:
        return Interval(float(np.exp(middle)), float("nan"), float("nan"))
    half = t_quantile((1 + level) / 2, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs))
    return Interval(
        float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))
    )


def geometric_mean_of(estimates: Sequence[LogEstimate], level: float = 0.95) -> Interval:
    """Geometric mean of independent measured quantities, with the noise of measuring alone.

    Give every estimate its own seed (or one generator in turn), or their resamples agree.
    """
    if not estimates:
        raise ValueError("no values")
    total = estimates[0]
    for estimate in estimates[1:]:
        total = total + estimate
    return _interval(total.scaled(1 / len(estimates)), level)


def _interval(estimate: LogEstimate, level: float) -> Interval:
    half = estimate.half_width(level)
    return Interval(
        estimate.value,
        float(np.exp(estimate.theta - half)),
        float(np.exp(estimate.theta + half)),
    )


def _all_positive(x: ArrayLike) -> NDArray:
    x = np.asarray(x, float).ravel()
    if not len(x):
        raise ValueError("no values")
    if not (x > 0).all():
        raise ValueError(f"a geometric mean needs values above zero, got {x[~(x > 0)][0]:g}")
    return x
