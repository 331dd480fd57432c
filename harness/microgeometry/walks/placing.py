"""Where the primitives of a bed stand: on a grid, or at random at a distance from one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError

Array = NDArray[np.float64]

_TRIES = 4000
"""Rejected points in a row after which a random arrangement counts as full."""


def grid(per_side: int) -> Array:
    """Centres [per_side^2, 2] of a square grid on the tile [0, 1)^2."""
    at = (np.arange(per_side) + 0.5) / per_side
    x, y = np.meshgrid(at, at)
    return np.stack([x.ravel(), y.ravel()], -1)


def staggered(per_side: int) -> Array:
    """The same, every other row moved by half a spacing; ``per_side`` is even."""
    if per_side % 2:
        raise InputError(f"per_side: expected an even number for 'staggered', got {per_side}")
    at = grid(per_side).reshape(per_side, per_side, 2)
    at[1::2, :, 0] += 0.5 / per_side
    return (at % 1).reshape(-1, 2)


def poisson(count: int, metric: Array, random: np.random.Generator) -> Array:
    """``count`` centres [count, 2] at random, no two nearer than 1 by ``metric`` [2, 2].

    The distance of two points is the length of ``metric`` times their difference on the torus of
    the tile: an ellipse's half axes times two, inverted, keep ellipses apart. Thrown one by one
    (random sequential adsorption), which fills 54.7 % of the plane with disks at most.

    Raises:
        InputError: so many do not fit.
    """
    found = np.empty((0, 2))
    while len(found) < count:
        for trial in random.random((_TRIES, 2)):
            if len(found) == 0 or nearest(found, trial, metric) >= 1:
                found = np.vstack([found, trial])
                break
        else:
            raise InputError(
                f"only {len(found)} of {count} primitives find a place without overlap;"
                " expected a smaller 'size', a smaller 'per_side' or a larger 'overlap'"
            )
    return found


def nearest(points: Array, at: Array, metric: Array) -> float:
    """Least distance by ``metric`` of ``at`` [2] and ``points`` [N, 2] on the torus."""
    apart = points - at
    apart -= np.round(apart)
    return float(np.sqrt(((apart @ metric.T) ** 2).sum(-1).min()))


def closest(points: Array, metric: Array) -> float:
    """Least distance by ``metric`` of any two of ``points``, or of one and its own next copy."""
    copies = np.array([(1, 0), (0, 1), (1, 1), (1, -1)], float)
    found = float(np.sqrt(((copies @ metric.T) ** 2).sum(-1).min()))
    for i, point in enumerate(points[1:], 1):
        found = min(found, nearest(points[:i], point, metric))
    return found
