r"""Importance weights: how unequal they are, how heavy their tail, and their mean if bounded.

For n numbers in [0, c] of sample variance V, at level :math:`\alpha`, whatever else they are
(empirical Bernstein bound, Maurer and Pontil 2009, theorem 4, in both directions):

.. math:: |\bar v - E[v]| \le \sqrt{2 V \ln(4/\alpha) / n} + 7 c \ln(4/\alpha) / (3 (n - 1))
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

COARSER = 4
"""Times the wanted resolution that a cap may leave unresolved if it keeps energy for that."""


def efficiency(weight: NDArray) -> float:
    """(sum w)^2 / (n sum w^2): 1 for equal weights, and 1 / (1 + chi-square divergence)."""
    # Scaled, so that the squares of very large weights stay finite.
    v = weight / weight.max()
    return float(v.sum() ** 2 / (len(v) * np.square(v).sum()))


def hill(weight: NDArray, k: int) -> tuple[float, float]:
    """Tail index of the ``k`` largest weights and its standard error (Hill 1975).

    Infinite where they are all equal: no tail.
    """
    top = np.sort(weight[weight > 0])[-(k + 1) :]
    if len(top) <= k:
        return math.inf, math.inf
    mean_log = float(np.log(top[1:] / top[0]).mean())
    return (1 / mean_log, 1 / mean_log / math.sqrt(k)) if mean_log > 0 else (math.inf, math.inf)


def choose_cap(pilot: NDArray, n: int, alpha: float, resolution: float) -> float:
    """The largest cap that lets ``n`` samples resolve the mean to ``resolution``.

    Candidates are the pilot's weights at ranks 1, 2, 4, ... from the top, and twice the
    largest. A cap below all weights that matter resolves nothing that does: where more than
    ``resolution`` of the mean would be cut off, up to ``COARSER`` times that may be unresolved,
    for the least of both together. Where no cap resolves as much, the one that resolves most.
    """
    ranked = np.sort(pilot[np.isfinite(pilot)])[::-1]
    ranks = 2 ** np.arange(int(math.log2(len(ranked))) + 1) - 1
    best, least, coarse = 0.0, math.inf, COARSER * resolution
    for cap in [2 * ranked[0], *ranked[ranks]]:
        v = np.minimum(ranked, cap)
        if not v.mean() > 0:
            continue
        relative = bernstein(v.var(ddof=1), cap, n, alpha) / v.mean()
        cut = 1 - v.mean() / ranked.mean()
        if relative <= resolution and cut <= resolution:
            return float(cap)
        # Any that resolves enough is before all that do not.
        loss = relative + (cut if relative <= coarse else 1)
        if loss < least:
            best, least = float(cap), loss
    return best


def bernstein(variance: float, cap: float, n: int, alpha: float) -> float:
    """By how much the mean of ``n`` numbers in [0, cap] may be off, at level ``alpha``."""
    log = math.log(4 / alpha)
    return math.sqrt(2 * variance * log / n) + 7 * cap * log / (3 * (n - 1))
