r"""The variance of one sample, averaged over pixels, with an interval that knows its tail.

Of B renders of P pixels each, :math:`y_{bp}` is the unbiased variance of one sample that render b
gives of pixel p. Their mean is the estimate. What is wrong with it comes from the deviations

.. math:: d_{bp} = \frac{B}{B-1} (y_{bp} - \bar y_p)

of each from the mean of the other renders of the same pixel: how pixels differ from each other is
no error. The index k of their upper tail decides:

- *light* (k < 1/2): the mean has a normal error, :math:`\sum (y - \bar y_p)^2 / (P^2 B (B - 1))`;
- *heavy*: the tail's share of the mean is what a generalised Pareto tail may have, by the profile
  likelihood of its mean; what lies below the threshold has a normal error;
- *not resolved*: where such a tail may have no mean at all, where the ends are more than a factor
  ``WIDEST`` apart, or where the largest deviation is of another kind than the rest of the tail.
  Then there is a lower bound alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats import tails
from harness.stats.distributions import pareto_sf, t_quantile
from harness.stats.log_interval import Z95, LogInterval

WIDEST = 10.0
"""Ends of an interval that are further apart, as a factor, are printed as no number."""
RESOLVED = ("light", "heavy")
"""Classes of tails whose variance has two ends."""
KNOWN = 1.5
"""Ends of another estimate that are further apart, as a factor, correct nothing."""
STRANGER = 1e-3
"""Probability of as large a largest deviation, below which it is of another kind."""


@dataclass(frozen=True)
class Deviations:
    """What is kept of all d: ``largest`` [M + 1] ascending, ``square`` the sum of d^2.

    ``count`` of them make a mean of standard error ``error``, if it has one, which is known with
    ``dof`` degrees of freedom.
    """

    largest: NDArray
    square: float
    count: int
    error: float
    dof: float

    @classmethod
    def of(cls, variances: ArrayLike) -> Deviations:
        """Of ``variances`` y [B, P] of B >= 2 renders."""
        y = np.asarray(variances, float)
        if y.ndim != 2 or len(y) < 2:
            raise ValueError(f"expected variances [B, P] of two renders or more, got {y.shape}")
        renders, pixels = y.shape
        d = (y - y.mean(0)) * (renders / (renders - 1))
        square = float(np.square(d).sum())
        error = math.sqrt(square * (renders - 1) / renders) / y.size
        return cls(tails.largest(d), square, y.size, error, float(pixels * (renders - 1)))

    def packed(self) -> NDArray:
        """All in one array [M + 5]; the inverse is :meth:`unpacked`."""
        return np.array([self.square, self.count, self.error, self.dof, *self.largest])

    @classmethod
    def unpacked(cls, packed: ArrayLike) -> Deviations:
        """The inverse of :meth:`packed`."""
        square, count, error, dof, *largest = np.asarray(packed, float)
        return cls(np.array(largest), float(square), int(count), float(error), float(dof))

    @classmethod
    def merged(cls, parts: Sequence[Deviations], weights: ArrayLike) -> Deviations:
        """Of the mean of the parts' means with ``weights`` that add up to one.

        Each d counts by its weight in that mean. Above the highest of the parts' thresholds the
        tail of all is known.
        """
        weights = np.asarray(weights, float)
        count = sum(part.count for part in parts)
        scale = [w * count / part.count for w, part in zip(weights, parts, strict=True)]
        tops = [k * part.largest for k, part in zip(scale, parts, strict=True)]
        ranked = np.sort(np.concatenate(tops))
        known = ranked[ranked >= max(top[0] for top in tops)]
        square = sum(k * k * part.square for k, part in zip(scale, parts, strict=True))
        errors = weights * [part.error for part in parts]
        error = float(np.sqrt(np.square(errors).sum()))
        shares = sum(e**4 / part.dof for e, part in zip(errors, parts, strict=True))
        dof = error**4 / shares if shares > 0 else sum(part.dof for part in parts)
        return cls(known[-tails.tail_size(count) - 1 :], float(square), count, error, float(dof))


@dataclass(frozen=True)
class Variance:
    """The estimate: ``log`` has its interval, ``tail`` its class, ``k`` the index (nan: unknown).

    ``log`` is None where the variance is not above zero: an exact sampler.
    """

    value: float
    log: LogInterval | None
    tail: tails.Class
    k: float = math.nan
    why: str = ""


def diagnosed(value: float, d: Deviations) -> Variance:
    """The mean ``value`` of y with the interval that its deviations allow."""
    if not value > 0:
        return Variance(value, None, "not diagnosed", why="no variance above rounding")
    if d.square == 0:
        return Variance(value, LogInterval(math.log(value), 0.0, 0.0), "light", -math.inf)
    excess = tails.Excesses.of(d.largest, d.count)
    k = tails.index(excess.values)
    if len(excess.values) < tails.FEWEST:
        return Variance(value, _normal(value, d), "not diagnosed", why="too few pixels for a tail")
    if stranger(excess):
        found = f"{_carried(value, d):.0%} of it lies in one of {d.count} pixels of renders"
        return Variance(value, lower_bound(value, d), "not resolved", k, found)
    if k < tails.LIGHT:
        return Variance(value, _normal(value, d), "light", k)
    log = tail_interval(value, d)
    if not log.factor <= WIDEST:
        why = f"the tail of its terms has index {k:.2f}"
        return Variance(value, lower_bound(value, d), "not resolved", k, why)
    return Variance(value, log, "heavy", k)


def less(second: Variance, square: float, error: float) -> Variance:
    """Of a second moment and the ``square`` of the mean, of standard error ``error``: the variance.

    Not diagnosed where the difference is not above its own error.
    """
    value = second.value - square
    if second.log is None or not value > 0:
        return Variance(value, None, "not diagnosed", why="no variance above rounding")
    _, low, high = second.log.interval
    low = value - math.hypot(second.value - low, Z95 * error)
    high = value + math.hypot(high - second.value, Z95 * error)
    if low <= 0:
        return Variance(value, None, "not diagnosed", second.k, "a difference of large moments")
    return replace(second, value=value, log=LogInterval.between(value, low, high))


def confirmed(plain: Variance, other: Variance | None) -> Variance:
    """``plain`` beside an ``other`` estimate of the same, by samples that miss less.

    The other is taken where the plain one does not resolve its tail and this one does, or where
    they contradict each other: a tail that the plain one did not meet. Where the plain one is
    light and that tail is not resolved by the other either, nothing is.
    """
    if other is None or other.log is None or plain.log is None:
        return plain
    if other.tail in RESOLVED:
        if not other.log.factor <= KNOWN:
            return plain
        narrower = other.log.factor < plain.log.factor
        return other if contradict(plain, other) or narrower else plain
    if plain.tail in RESOLVED and other.log.interval.low > plain.log.interval.high:
        why = "samples that are not the method's find a tail that its own do not meet"
        return replace(other, tail="not resolved", why=why)
    return plain


def contradict(plain: Variance, other: Variance) -> bool:
    """Whether the two are more than three standard errors apart."""
    first, second = plain.log.interval, other.log.interval
    if second.value < first.value:
        first, second = second, first
    error = math.hypot(first.high - first.value, second.value - second.low) / Z95
    return second.value - first.value > 3 * error


def stranger(excess: tails.Excesses) -> bool:
    """Whether the largest is too large for the tail that all others have."""
    x = excess.values[excess.values > 0]
    if len(x) < tails.FEWEST or x[0] == x[-2]:
        return False
    rest = x[:-1]
    # Of few values an index below zero, a tail with an end, is mostly chance.
    k = max(tails.index(rest), 0.01)
    sigma = float(np.median(rest)) * k / (2**k - 1)
    return bool(len(x) * pareto_sf(x[-1], k, sigma) < STRANGER)


def _carried(value: float, d: Deviations) -> float:
    """Share of the mean that the largest deviation makes."""
    return float(d.largest[-1]) / d.count / value


def _normal(value: float, d: Deviations) -> LogInterval:
    half = float(t_quantile(0.975, d.dof)) * d.error / value
    return LogInterval(math.log(value), half, half)


def tail_interval(
    value: float, d: Deviations, prior: tuple[float, float] | None = None
) -> LogInterval:
    """Of the mean ``value``, with all that a generalised Pareto tail may hold; see above."""
    excess = tails.Excesses.of(d.largest, d.count)
    mean = tails.mean_excess(excess.values, prior=prior)
    noise = _below(d, excess, mean.value)
    plain = float(excess.values.mean())
    middle = value + excess.share * (mean.value - plain)
    low = middle - math.hypot(Z95 * noise, excess.share * (mean.value - mean.low))
    high = middle + math.hypot(Z95 * noise, excess.share * (mean.high - mean.value))
    # Not narrower than if the tail were light; the estimate itself is one that the data allow.
    half = Z95 * d.error
    low, high = min(low, value - half), max(high, value + half)
    return LogInterval.between(value, max(low, 0.0), high)


def lower_bound(value: float, d: Deviations) -> LogInterval:
    """A lower bound of it alone: of a tail without its largest, which may be luck."""
    excess = tails.Excesses.of(d.largest, d.count)
    mean = tails.mean_excess(excess.values[:-1])
    low = value + excess.share * (mean.low - float(excess.values.mean()))
    low = min(low - Z95 * _below(d, excess, mean.low), value)
    return LogInterval.between(value, max(low, 0.0), math.inf)


def _below(d: Deviations, excess: tails.Excesses, mean: float) -> float:
    """Standard error of what the threshold cuts off, and of how many lie above it."""
    many = len(excess.values)
    above = np.square(excess.threshold + excess.values).sum()
    clipped = d.square - above + many * excess.threshold**2
    return math.hypot(math.sqrt(max(clipped, 0.0)), math.sqrt(many) * mean) / d.count
