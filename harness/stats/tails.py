r"""How heavy the upper tail of numbers is whose mean is wanted, told from the largest of them.

Above a high threshold u the excess x of almost any distribution follows the generalised Pareto
distribution,

.. math:: P(X > x) = (1 + k x / \sigma)^{-1/k}, \qquad E[X] = \sigma / (1 - k) \quad (k < 1),

whose index k says which moments there are: below 1/2 a variance, and a mean whose error is
normal; below 1 a mean; from 1 on none. ``k`` is estimated as Zhang and Stephens (2009, A new and
efficient estimation method for the generalized Pareto distribution) do, drawn towards 1/2 with
the weight of ten values (Vehtari et al., Pareto smoothed importance sampling).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats.distributions import chi2_isf

Class = Literal["light", "heavy", "not resolved", "not diagnosed"]

LIGHT = 0.5
"""Index below which the numbers have a variance, and their mean a normal error."""
FEWEST = 20
"""Fewest excesses to fit an index to."""
ROUNDING = 1e-5
"""Relative difference of numbers that are the same."""
_PRIOR = 10.0
_INDICES = np.concatenate([np.linspace(-1.0, -0.05, 8), np.linspace(0.02, 0.995, 60)])
"""Indices that a profile likelihood is taken over: below one, where there is a mean."""


@dataclass(frozen=True)
class Excesses:
    """The largest of N numbers: how far each of M [M] lies above ``threshold``, ascending."""

    threshold: float
    values: NDArray
    count: int

    @classmethod
    def of(cls, largest: ArrayLike, count: int) -> Excesses:
        """Of the ``largest`` [M + 1] of ``count`` numbers; the smallest is the threshold."""
        ranked = np.sort(np.asarray(largest, float).ravel())
        if len(ranked) < 2 or not np.isfinite(ranked).all():
            raise ValueError("expected two finite numbers or more")
        excess = ranked[1:] - ranked[0]
        # Ties, but for rounding: numbers come from sums in single precision.
        excess[excess < ROUNDING * abs(ranked[0])] = 0.0
        return cls(float(ranked[0]), excess, int(count))

    @property
    def share(self) -> float:
        """Of all numbers, those above the threshold."""
        return len(self.values) / self.count


def tail_size(count: int) -> int:
    """How many of ``count`` numbers are the tail: a fifth, at most 3 sqrt(count)."""
    return int(min(count / 5, 3 * math.sqrt(count)))


def largest(values: ArrayLike) -> NDArray:
    """Those of ``values`` that a diagnosis needs, ascending: the tail and its threshold."""
    flat = np.ravel(values)
    keep = min(len(flat), tail_size(len(flat)) + 1)
    return np.sort(np.partition(flat, len(flat) - keep)[len(flat) - keep :])


def fit(excess: ArrayLike) -> tuple[float, float]:
    """(k, sigma) of excesses [M] over their threshold; no prior.

    Raises:
        ValueError: fewer than two different values above zero.
    """
    x = np.sort(np.asarray(excess, float).ravel())
    x = x[x > 0]
    n = len(x)
    if n < 2 or x[0] == x[-1]:
        raise ValueError("a tail needs two different values above its threshold")
    many = 20 + int(math.sqrt(n))
    quartile = x[max(int(n / 4 + 0.5) - 1, 0)]
    steps = 1 - np.sqrt(many / (np.arange(1, many + 1) - 0.5))
    b = 1 / x[-1] + steps / (3 * quartile)
    k = np.log1p(-b[:, None] * x).mean(1)
    likelihood = n * (np.log(-b / k) - k - 1)
    weight = np.exp(likelihood - likelihood.max())
    mean = float((b * weight).sum() / weight.sum())
    found = float(np.log1p(-mean * x).mean())
    return found, -found / mean


def index(excess: ArrayLike) -> float:
    """k of excesses [M], drawn towards 1/2; minus infinity where they are all equal: no tail."""
    x = np.asarray(excess, float).ravel()
    x = x[x > 0]
    if len(x) < 2 or x.min() == x.max():
        return -math.inf
    k, _ = fit(x)
    return float((len(x) * k + _PRIOR * 0.5) / (len(x) + _PRIOR))


@dataclass(frozen=True)
class TailMean:
    """Mean of the excesses as the fitted tail has it, [low, high] at the wanted level."""

    value: float
    low: float
    high: float


def mean_excess(
    excess: ArrayLike, level: float = 0.95, prior: tuple[float, float] | None = None
) -> TailMean:
    """Mean of a generalised Pareto tail, with the interval of its profile likelihood.

    The upper end is very large where an index near one, which has no mean, fits well enough.
    ``prior`` is the mean and deviation of a normal prior of the index, for tails of so few values
    that any index fits.
    """
    x = np.asarray(excess, float).ravel()
    x = x[x > 0]
    plain = float(x.mean())
    # A grid around the plain mean, which underestimates that of a heavy tail.
    means = plain * np.exp(np.linspace(math.log(0.2), math.log(1e4), 161))
    profile = _profile(x, means, prior)
    best = int(profile.argmax())
    inside = profile > profile[best] - chi2_isf(1 - level, 1) / 2
    first, last = int(inside.argmax()), len(means) - 1 - int(inside[::-1].argmax())
    low = _crossing(means, profile, first, profile[best] - chi2_isf(1 - level, 1) / 2, -1)
    high = _crossing(means, profile, last, profile[best] - chi2_isf(1 - level, 1) / 2, +1)
    return TailMean(float(means[best]), low, high)


def _profile(x: NDArray, means: NDArray, prior: tuple[float, float] | None) -> NDArray:
    """Largest log likelihood of x [M] with each of ``means`` [K], over the index."""
    sigma = means[:, None] * (1 - _INDICES)
    ratio = _INDICES / sigma
    found = np.full(sigma.shape, -np.inf)
    # 1 + k x / sigma > 0 for all x, or x is beyond the end of such a tail.
    ok = 1 + ratio * x.max() > 0
    terms = _log_sums(x, ratio[ok])
    k = np.broadcast_to(_INDICES, sigma.shape)[ok]
    found[ok] = -len(x) * np.log(sigma[ok]) - (1 + 1 / k) * terms
    if prior is not None:
        found[ok] -= np.square((k - prior[0]) / prior[1]) / 2
    return found.max(1)


def _log_sums(x: NDArray, ratio: NDArray) -> NDArray:
    """Sum of log(1 + r x) for each ratio r [K]; between 400 of them where they are positive."""
    found, up = np.empty_like(ratio), ratio > 0
    found[~up] = np.log1p(ratio[~up][:, None] * x).sum(1)
    if up.any():
        logs = np.log(ratio[up])
        grid = np.linspace(logs.min(), logs.max(), 400)
        found[up] = np.interp(logs, grid, np.log1p(np.exp(grid)[:, None] * x).sum(1))
    return found


def _crossing(means: NDArray, profile: NDArray, at: int, level: float, step: int) -> float:
    """Where the profile falls to ``level`` beyond point ``at``, linear between logarithms."""
    other = at + step
    if not 0 <= other < len(means):
        return math.inf if step > 0 else 0.0
    if not np.isfinite(profile[other]):
        return float(means[at])
    share = (profile[at] - level) / (profile[at] - profile[other])
    return float(means[at] * (means[other] / means[at]) ** share)
