"""The inverse of the steps of :mod:`harness.nets.discrete_flow`, over columns.

Newton's method, step after step from the last: by the compiled kernels where they can run it,
otherwise as loops inside one kernel of Dr.Jit's. Rows that it does not bring home are searched
again, in a way that goes across folds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol import counting
from harness.nets import compiled_flow
from harness.nets.discrete_flow import ROUNDS, DiscreteFlow
from harness.nets.discrete_flow_columns import (
    ColumnOrigin,
    compiled,
    determinant,
    loop,
    one,
    one_dual,
    solve,
    step_count,
)
from harness.nets.velocity import Shared

_TOLERANCE = 2.0**-21
"""Of a step's end, relative to the places; a last step of Newton's squares it. The determinant is
that of the place before: with four times as much, densities were off by up to 2e-4."""
_REACH = 0.1
"""The longest move of a round of the second search: short of the places between which a velocity
differs."""
_MOVES, _STARTS = 32, 12
"""Of the second search, from one start, and starts: some run in circles, few of them from all."""
_LAST = 2.0**-17
"""As ``_TOLERANCE`` where no step follows that squares it."""

Search = Callable[[DiscreteFlow, Columns, Any, Columns, Any], tuple[Columns, Float, Any]]
"""An ``x`` that step ``k`` takes to a target, the determinant there, and whether it was found."""


def invert(flow: DiscreteFlow, x: Columns, shared: Shared, active: Any = True) -> ColumnOrigin:
    """The start of what ends in ``x``; and whether it was found.

    First as :meth:`DiscreteFlow.invert`: a step of Newton's has to come nearer every time, and is
    halved until it does. That stops at a fold, where the determinant is zero, and on rare ways to
    places where no sample falls. From such rows every step is taken, no longer than ``_REACH``,
    from several starts. A velocity that is bounded makes of a step a map of degree one: every place
    has an origin, and beyond a fold more than one.

    Rows that are not ``active`` stay where they are, and packets of rows without an active one
    cost nothing.
    """
    origin = first_search(flow, x, shared, active)
    mask = dr.mask_t(type(x[0]))
    lost = mask(active) & ~origin.found & dr.isfinite(x[0]) & dr.isfinite(x[1])
    # Inside of a kernel that is being recorded nobody can look.
    if dr.flag(dr.JitFlag.SymbolicScope) or dr.any(lost)[0]:
        again = _by(_bounded_newton, flow, x, shared, lost)
        place = [dr.select(lost, a, b) for a, b in zip(again.x, origin.x, strict=True)]
        found = dr.select(lost, again.found, origin.found)
        origin = ColumnOrigin(place, dr.select(lost, again.det, origin.det), found)
    if counting.wanted():
        counting.add("not inverted", dr.count(mask(active) & ~origin.found)[0])
    return origin


def first_search(
    flow: DiscreteFlow, x: Columns, shared: Shared, active: Any = True
) -> ColumnOrigin:
    """As :meth:`DiscreteFlow.invert`."""
    done = compiled(compiled_flow.INVERSE, flow, x, shared, active)
    if done is not None:
        return ColumnOrigin(done[:2], done[2], done[3] != 0)
    return _by(_newton, flow, x, shared, active)


def _by(
    search: Search, flow: DiscreteFlow, x: Columns, shared: Shared, active: Any
) -> ColumnOrigin:
    """All steps inverted by ``search``, in one kernel."""
    array = type(shared.columns[0])
    mask = dr.mask_t(array)

    def body(k: Any, x: Float, y: Float, det: Float, found: Any, active: Any) -> tuple:
        k = k - 1
        (x, y), of_step, converged = search(flow, [x, y], k, shared.columns, active)
        return k, x, y, det * of_step, found & converged, active

    start = step_count(flow, array), *(array(v) for v in x), array(1), mask(True), mask(active)
    _, x, y, det, found, _ = loop(
        start, lambda k, x, y, det, found, active: active & (k > 0), body, "flow inverse"
    )
    return ColumnOrigin([x, y], det, found)


def _newton(
    flow: DiscreteFlow, target: Columns, k: Any, shared: Columns, active: Any
) -> tuple[Columns, Float, Any]:
    """A step of Newton's that does not come nearer is halved."""
    array = type(shared[0])
    index = dr.uint32_array_t(array)
    guess = one(flow, target, k, shared, back=True)
    goal = _TOLERANCE * (1 + _size(target) + _size(guess))

    def body(
        i: Any, x: Float, y: Float, dx: Float, dy: Float, left: Float,
        a: Float, c: Float, b: Float, d: Float, rx: Float, ry: Float,
    ) -> tuple:  # fmt: skip
        trial = [x + dx, y + dy]
        out, m = one_dual(flow, trial, k, shared)
        right = [t - o for t, o in zip(target, out, strict=True)]
        away = _size(right)
        better = away < left
        kept = [
            dr.select(better, new, old)
            for new, old in zip([*trial, *m, *right], [x, y, a, c, b, d, rx, ry], strict=True)
        ]
        x, y, *matrix, rx, ry = kept
        newton = solve(tuple(matrix), [rx, ry])
        dx, dy = (
            dr.select(better, new, 0.5 * old) for new, old in zip(newton, [dx, dy], strict=True)
        )
        return i + 1, x, y, dx, dy, dr.select(better, away, left), *matrix, rx, ry

    zero, far = array(0), array(dr.inf)
    start = (
        index(0), *(array(v) for v in guess), zero, zero, far,
        array(1), zero, zero, array(1), zero, zero,
    )  # fmt: skip
    found = loop(
        start,
        lambda i, x, y, dx, dy, left, *rest: (i < ROUNDS) & ~(left <= goal),
        body,
        "newton",
    )
    _, x, y, _, _, left, *matrix, rx, ry = found
    move = solve(tuple(matrix), [rx, ry])
    return [x + move[0], y + move[1]], determinant(tuple(matrix)), left <= 64 * goal


def _bounded_newton(
    flow: DiscreteFlow, target: Columns, k: Any, shared: Columns, active: Any
) -> tuple[Columns, Float, Any]:
    """Every step is taken, but none longer than ``_REACH``; from ``_STARTS`` starts."""
    array = type(shared[0])
    index, mask = dr.uint32_array_t(array), dr.mask_t(array)
    guess = one(flow, target, k, shared, back=True)
    goal = _LAST * (1 + _size(target) + _size(guess))
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
        start = i // _MOVES
        anew = (i % _MOVES == _MOVES - 1) & (_size(right) > goal)
        sin, cos = dr.sincos(2.4 * array(start))
        radius = array(start + 1) * reach
        x = dr.select(anew, dr.fma(radius, cos, target[0]), x)
        y = dr.select(anew, dr.fma(radius, sin, target[1]), y)
        return i + 1, x, y, determinant(along), _size(right), active

    start = index(0), *(array(v) for v in guess), array(1), array(dr.inf), mask(active)
    _, x, y, det, left, _ = loop(
        start,
        lambda i, x, y, det, left, active: active & (i < _MOVES * _STARTS) & ~(left <= goal),
        body,
        "bounded newton",
    )
    return [x, y], det, left <= goal


def _size(v: Columns) -> Float:
    return dr.maximum(dr.abs(v[0]), dr.abs(v[1]))
