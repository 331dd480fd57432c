r"""Pearson's chi-square test against known expected counts.

.. math:: X^2 = \sum_i \frac{(O_i - E_i)^2}{E_i + V_i}

with :math:`V_i` the variance of :math:`E_i` itself where that was integrated by Monte
Carlo. Cells with too small an *expected* count are pooled, smallest first. What was
observed plays no part in that: a test that skips cells with few observed samples
lets a missing lobe pass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from harness.stats.distributions import chi2_sf


class ChiSquare(NamedTuple):
    """A test's outcome; ``worst`` is the index of the given cell of the largest |z|."""

    statistic: float
    dof: int
    p_value: float
    worst: int


def sidak(alpha: float, tests: int) -> float:
    """Level of each of ``tests`` independent tests for a level ``alpha`` of all together."""
    if tests < 1:
        raise ValueError(f"expected at least one test, got {tests}")
    # 1 - (1-a)^(1/n), without cancellation for small a.
    return float(-np.expm1(np.log1p(-alpha) / tests))


def chi_square(
    observed: ArrayLike,
    expected: ArrayLike,
    variance: ArrayLike | None = None,
    minimum: float = 5.0,
) -> ChiSquare:
    """Goodness of fit of counts ``observed`` [n] to ``expected`` [n].

    Together the cells must hold every sample (invalid ones are a cell of their own), so
    there is one degree of freedom less than cells after pooling. ``variance`` [n] is the
    uncertainty of ``expected`` in counts squared. Expected counts may come out slightly
    negative from integration noise; they pool with the smallest.

    Raises:
        ValueError: shapes differ or a number is not finite.
    """
    observed = np.asarray(observed, float).ravel()
    expected = np.asarray(expected, float).ravel()
    spread = np.zeros_like(expected) if variance is None else np.asarray(variance, float).ravel()
    if not observed.shape == expected.shape == spread.shape:
        raise ValueError(f"shapes differ: {observed.shape}, {expected.shape}, {spread.shape}")
    if not all(np.isfinite(a).all() for a in (observed, expected, spread)):
        raise ValueError("counts must be finite")
    group = _pool(expected, minimum)
    o, e, v = (np.bincount(group, a) for a in (observed, expected, spread))
    if len(o) < 2:
        # All in one cell: it holds every sample by definition, and nothing can be tested.
        return ChiSquare(0.0, 0, 1.0, 0)
    statistic = float(((o - e) ** 2 / (e + v)).sum())
    z = np.abs(o - e) / np.sqrt(e + v)
    members = np.flatnonzero(group == z.argmax())
    worst = int(members[np.abs(observed - expected)[members].argmax()])
    dof = len(o) - 1
    return ChiSquare(statistic, dof, float(chi2_sf(statistic, dof)), worst)


def _pool(expected: np.ndarray, minimum: float) -> np.ndarray:
    """Group number of each cell, such that every group expects at least ``minimum``."""
    order = np.argsort(expected, kind="stable")
    group = np.empty(len(expected), int)
    number, total = 0, 0.0
    for position, cell in enumerate(order):
        group[cell] = number
        total += expected[cell]
        if total >= minimum:
            if expected[cell] >= minimum:
                # All later cells are at least as large: each stands alone.
                rest = order[position + 1 :]
                group[rest] = number + 1 + np.arange(len(rest))
                return group
            number, total = number + 1, 0.0
    # The last group fell short: it joins the one before.
    group[group == number] = max(number - 1, 0)
    return group
