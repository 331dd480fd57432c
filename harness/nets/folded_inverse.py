"""The inverse of flows whose steps fold: an origin, where there are several."""

from __future__ import annotations

from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.discrete_flow_columns import (
    ColumnOrigin,
    determinant,
    invert,
    one,
    one_dual,
    solve,
)
from harness.nets.velocity import Shared

_REACH = 0.1
"""The longest move of one round: short of the places between which a velocity differs."""
_ROUNDS, _STARTS = 32, 12
"""Moves from one start, and starts: some run in circles, few of them from all."""
_TOLERANCE = 2.0**-17
"""Of a step's end, relative to the places."""


def invert_across_folds(flow: DiscreteFlow, x: Columns, shared: Shared) -> ColumnOrigin:
    """As :func:`harness.nets.discrete_flow_columns.invert`, and further where that finds nothing.

    A step of Newton's that has to come nearer every time stops at a fold, where the determinant is
    zero. From there on every step is taken, no longer than ``_REACH``, which goes across. A
    velocity that is bounded makes of a step a map of degree one: every place has an origin.
    """
    origin = invert(flow, x, shared)
    again = _second_search(flow, x, shared, ~origin.found)
    place = [dr.select(origin.found, a, b) for a, b in zip(origin.x, again.x, strict=True)]
    det = dr.select(origin.found, origin.det, again.det)
    return ColumnOrigin(place, det, origin.found | again.found)


def _second_search(flow: DiscreteFlow, x: Columns, shared: Shared, active: Any) -> ColumnOrigin:
    array = type(shared.columns[0])
    mask = dr.mask_t(array)

    def body(k: Any, x: Float, y: Float, det: Float, found: Any, active: Any) -> tuple:
        k = k - 1
        (x, y), of_step, converged = _bounded_newton(flow, [x, y], k, shared.columns, active)
        return k, x, y, det * of_step, found & converged, active

    count = dr.opaque(dr.uint32_array_t(array), flow.steps)
    start = count, *(array(v) for v in x), array(1), mask(True), mask(active)
    _, x, y, det, found, _ = dr.while_loop(
        start,
        lambda k, x, y, det, found, active: active & (k > 0),
        body,
        mode="symbolic",
        label="folded flow inverse",
    )
    return ColumnOrigin([x, y], det, found)


def _bounded_newton(
    flow: DiscreteFlow, target: Columns, k: Any, shared: Columns, active: Any
) -> tuple[Columns, Float, Any]:
    """An ``x`` that step ``k`` takes to ``target``, the determinant there, whether it was found."""
    array = type(shared[0])
    index, mask = dr.uint32_array_t(array), dr.mask_t(array)
    guess = one(flow, target, k, shared, back=True)
    goal = _TOLERANCE * (1 + _size(target) + _size(guess))
    # The last start is twice as far as a step moves, or a move of one round per start.
    moved = [a - b for a, b in zip(target, guess, strict=True)]
    reach = dr.maximum(_REACH, 2 / _STARTS * _size(moved))

    def body(
        i: Any, x: Float, y: Float, det: Float, left: Float, active: Any
    ) -> tuple[Any, Float, Float, Float, Float, Any]:
        out, along = one_dual(flow, [x, y], k, shared)
        right = [t - o for t, o in zip(target, out, strict=True)]
        move = solve(along, right)
        # At a fold there is no such step: a short one aside.
        size = _size(move)
        move = [dr.select(dr.isfinite(v), v, _REACH) for v in move]
        shorter = dr.select(size > _REACH, _REACH / dr.maximum(size, _REACH), 1)
        shorter = dr.select(dr.isfinite(size), shorter, 1)
        shorter = dr.select(_size(right) <= goal, 0, shorter)
        x, y = (dr.fma(shorter, v, at) for v, at in zip(move, (x, y), strict=True))
        # Another start about the target, further out each time, in another direction.
        start = i // _ROUNDS
        anew = (i % _ROUNDS == _ROUNDS - 1) & (_size(right) > goal)
        sin, cos = dr.sincos(2.4 * array(start))
        radius = array(start + 1) * reach
        x = dr.select(anew, dr.fma(radius, cos, target[0]), x)
        y = dr.select(anew, dr.fma(radius, sin, target[1]), y)
        return i + 1, x, y, determinant(along), _size(right), active

    start = index(0), *(array(v) for v in guess), array(1), array(dr.inf), mask(active)
    _, x, y, det, left, _ = dr.while_loop(
        start,
        lambda i, x, y, det, left, active: active & (i < _ROUNDS * _STARTS) & ~(left <= goal),
        body,
        mode="symbolic",
        label="bounded newton",
    )
    return [x, y], det, left <= goal


def _size(v: Columns) -> Float:
    return dr.maximum(dr.abs(v[0]), dr.abs(v[1]))
