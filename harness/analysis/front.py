r"""Pareto fronts of points whose two coordinates are known up to an interval; less is better.

A point is *surely* dominated if some other point's intervals lie wholly below its own on both
axes. It is *possibly* dominated if another's values are no worse on both axes and better on
one, but an interval overlaps. Otherwise it is on the front, to which it belongs with a
probability: the share of draws from all intervals in which nothing dominates it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from harness.analysis.combine import Z95, Estimate

Place = Literal["front", "possibly", "surely"]
_DRAWS = 2000


@dataclass(frozen=True)
class Standing:
    """Where a point stands: on the front, possibly dominated or surely.

    ``membership`` is the probability of being undominated, given all intervals.
    """

    place: Place
    membership: float


def standings(points: Sequence[tuple[Estimate, Estimate]]) -> list[Standing]:
    """Standing of each point ``(x, y)``, both positive and finite, among all of them.

    Raises:
        ValueError: a value is not positive and finite, and so has no place on log axes.
    """
    if not points:
        return []
    value = np.array([[x.value, y.value] for x, y in points])
    if not ((value > 0) & np.isfinite(value)).all():
        raise ValueError("a front needs values that are positive and finite")
    low = np.array([[_low(x), _low(y)] for x, y in points])
    high = np.array([[_high(x), _high(y)] for x, y in points])
    surely = (high[:, None] < low[None]).all(-1).any(0)
    by_value = _dominated(value[None])[0]
    membership = 1 - _dominated(_drawn(points)).mean(0)
    return [
        Standing("surely" if s else "possibly" if v else "front", float(m))
        for s, v, m in zip(surely, by_value, membership, strict=True)
    ]


def _dominated(at: NDArray) -> NDArray:
    """Whether another point is no worse on both axes and better on one, [D, N, 2] -> [D, N]."""
    x, y = at[..., 0], at[..., 1]
    found = np.zeros(x.shape, bool)
    for other in range(x.shape[1]):
        ox, oy = x[:, other, None], y[:, other, None]
        found |= (ox <= x) & (oy <= y) & ((ox < x) | (oy < y))
    return found


def _drawn(points: Sequence[tuple[Estimate, Estimate]]) -> NDArray:
    """Log-normal draws of all coordinates, independent, [D, N, 2]."""
    centre = np.log([[x.value, y.value] for x, y in points])
    spread = np.array([[_log_spread(x), _log_spread(y)] for x, y in points])
    random = np.random.default_rng(0)  # fixed: the same records give the same figure
    return centre + spread * random.standard_normal((_DRAWS, *centre.shape))


def _log_spread(estimate: Estimate) -> float:
    """Standard deviation of the logarithm that the interval tells; 0 without one."""
    if not estimate.has_interval:
        return 0.0
    if estimate.low > 0:
        return (math.log(estimate.high) - math.log(estimate.low)) / (2 * Z95)
    # A lower bound of zero or less says nothing on a log scale: the upper half has to do.
    return (math.log(estimate.high) - math.log(estimate.value)) / Z95


def _low(estimate: Estimate) -> float:
    return estimate.low if estimate.has_interval else estimate.value


def _high(estimate: Estimate) -> float:
    return estimate.high if estimate.has_interval else estimate.value
