"""The way from point to point along a knob, where one of them has no known value."""

from __future__ import annotations

import itertools
import math

Spot = tuple[float, float]


def inserted(route: list[Spot], base: Spot) -> list[Spot]:
    """``route`` with ``base`` where it makes the shortest way on log axes.

    A suite does not say which value of a knob a method has that leaves it at its default.
    """
    options = [[*route[:i], base, *route[i:]] for i in range(len(route) + 1)]
    return min(options, key=_length)


def _length(route: list[Spot]) -> float:
    return sum(
        math.hypot(math.log(b[0] / a[0]), math.log(b[1] / a[1]))
        for a, b in itertools.pairwise(route)
    )
