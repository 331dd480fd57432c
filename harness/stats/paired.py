"""The ratio of two variances whose renders used the same random numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats.distributions import t_quantile
from harness.stats.log_interval import LogInterval

CORRELATED = 0.5
"""Correlation from which pairing is worth more than the renders that are not paired."""


@dataclass(frozen=True)
class Paired:
    """``ratio`` of mean(a) over mean(b), its errors taken together; ``correlation`` of the two."""

    ratio: LogInterval
    correlation: float
    same: bool
    """Whether the two are the same in every render: a clone."""


def paired_ratio(a: ArrayLike, b: ArrayLike, pixels: ArrayLike) -> Paired | None:
    """Of variances [B, G] of groups of ``pixels`` [G], in renders of the same random numbers.

    Of unequally many renders those in common count. The error is that of ``a/mean(a) -
    b/mean(b)`` over renders, group by group; Student's t. None for fewer than two renders, or
    a mean that is not above zero.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    n = min(len(a), len(b))
    if n < 2 or a.shape[1:] != b.shape[1:]:
        return None
    weight = np.asarray(pixels, float) / np.sum(pixels)
    a, b = a[:n], b[:n]
    means = [float((x.mean(0) * weight).sum()) for x in (a, b)]
    if not min(means) > 0:
        return None
    theta = math.log(means[0] / means[1])
    if np.array_equal(a, b):
        return Paired(LogInterval(theta, 0.0, 0.0), 1.0, True)
    x, y = a / means[0], b / means[1]
    together, alone_x, alone_y = (_error2(v, weight) for v in (x - y, x, y))
    scale = 2 * math.sqrt(alone_x * alone_y)
    correlation = (alone_x + alone_y - together) / scale if scale > 0 else 0.0
    dof = a.shape[1] * (n - 1)
    half = float(t_quantile(0.975, dof)) * math.sqrt(together)
    return Paired(LogInterval(theta, half, half), correlation, False)


def _error2(x: NDArray, weight: NDArray) -> float:
    """Squared standard error of the weighted mean of x [B, G] over renders."""
    return float((weight**2 * x.var(0, ddof=1)).sum() / len(x))
