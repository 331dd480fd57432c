r"""Straight lines of total cost, and where they cross.

A method costs :math:`F` seconds before its first sample and :math:`c` seconds for each unit of
work after it: :math:`T(n) = F + c\,n`. It is ahead of a rival where its line is below:

.. math:: n^* = \frac{F - F_r}{c_r - c} .

Values may be single numbers or draws [R] that hold their uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Kind = Literal["always", "from", "until", "never"]


@dataclass(frozen=True)
class Crossing:
    """Where one line is below another: always, from or until ``at``, or never.

    ``low`` and ``high`` bound ``at`` (infinite where the draws include never, or for ever).
    ``sure`` is the share of draws of the same kind.
    """

    kind: Kind
    at: float
    low: float
    high: float
    sure: float


def crossing(
    fixed: ArrayLike, slope: ArrayLike, rival_fixed: ArrayLike, rival_slope: ArrayLike
) -> Crossing:
    """Where ``fixed + slope n`` is at most the rival's, for n from 0.

    Each is [R + 1]: the value itself, then draws of it, row by row together.
    """
    saved = np.asarray(rival_slope, float) - np.asarray(slope, float)
    extra = np.asarray(fixed, float) - np.asarray(rival_fixed, float)
    saved, extra = np.broadcast_arrays(np.atleast_1d(saved), np.atleast_1d(extra))
    kinds = _kinds(extra, saved)
    with np.errstate(divide="ignore", invalid="ignore"):
        point = extra / saved
    kind = kinds[0]
    if kind == "until":
        # Never ahead: until nothing. A later start says nothing of an end: for ever.
        at = np.select([kinds == "until", kinds == "never"], [point, 0.0], math.inf)
    else:
        # Ahead only at first is not ahead from some point on.
        at = np.select([kinds == "from", kinds == "always"], [point, 0.0], math.inf)
    low, high = _quantiles(at[1:] if len(at) > 1 else at)
    return Crossing(kind, float(at[0]), low, high, float((kinds == kind).mean()))


def envelope(fixed: ArrayLike, slope: ArrayLike) -> list[tuple[int, float, float]]:
    """The lowest of the lines [M] from 0 to infinity, as (line, from, to) in order."""
    fixed, slope = np.asarray(fixed, float), np.asarray(slope, float)
    here, at, found = int(np.lexsort((slope, fixed))[0]), 0.0, []
    while True:
        flatter = np.nonzero(slope < slope[here])[0]
        if not len(flatter):
            return [*found, (here, at, math.inf)]
        points = (fixed[flatter] - fixed[here]) / (slope[here] - slope[flatter])
        # Of those that cross here at once the flattest stays below.
        first = flatter[np.lexsort((slope[flatter], points))[0]]
        after = float(points.min())
        if after > at:
            found.append((here, at, after))
        here, at = int(first), after


def _kinds(extra: NDArray, saved: NDArray) -> NDArray:
    """Of each row; a line that is nowhere above another is always ahead of it."""
    conditions = [(extra <= 0) & (saved >= 0), (extra > 0) & (saved > 0), extra > 0]
    return np.select(conditions, ["always", "from", "never"], "until")


def _quantiles(at: NDArray) -> tuple[float, float]:
    """Of values that may be infinite: order statistics, nothing is interpolated."""
    ordered = np.sort(at)
    last = len(ordered) - 1
    return float(ordered[math.floor(0.025 * last)]), float(ordered[math.ceil(0.975 * last)])
