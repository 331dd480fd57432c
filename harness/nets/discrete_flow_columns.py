"""The steps of :mod:`harness.nets.discrete_flow` over columns.

By the compiled kernels where they can run them (Euler's method, columns that have values);
otherwise as loops inside one kernel of Dr.Jit's.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.nets import compiled_flow
from harness.nets.compiled_network import usable
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.solvers import step
from harness.nets.velocity import Shared

Matrix = tuple[Float, Float, Float, Float]
"""Derivatives by x, then by y: (a, c, b, d) of rows (a, b), (c, d)."""


class ColumnMoved(NamedTuple):
    """See :class:`harness.nets.discrete_flow.Moved`; the determinant itself, not its logarithm."""

    x: Columns
    det: Float
    jacobian: Matrix


class ColumnOrigin(NamedTuple):
    """See :class:`harness.nets.discrete_flow.Origin`."""

    x: Columns
    det: Float
    found: Any


def compiled(
    way: int, flow: DiscreteFlow, x: Columns, shared: Shared, active: Any = True
) -> Columns | None:
    """Outputs of the compiled kernel ``way``; None where it cannot run the flow."""
    if flow.solver != "euler" or not flow.velocity.compilable:
        return None
    masked = active is not True
    encoded = shared.encoded
    own = flow.velocity.layers[0].out_features
    library = usable(encoded, *x, *([active] if masked else []), widths=(encoded.width, own))
    if library is None:
        return None
    packed = flow.velocity.compiled(library)
    return packed.run(way, flow.steps, encoded, x, active if masked else None)


def _width(flow: DiscreteFlow, array: type[Float]) -> Float:
    """1 / S, as data: one kernel serves every number of steps."""
    return dr.opaque(array, 1 / flow.steps)


def step_count(flow: DiscreteFlow, array: type[Float]) -> Any:
    """S, as data."""
    return dr.opaque(dr.uint32_array_t(array), flow.steps)


def _add(x: Columns, h: Float, k: Columns) -> Columns:
    return [dr.fma(b, h, a) for a, b in zip(x, k, strict=True)]


def determinant(m: Matrix) -> Float:
    """Of derivatives."""
    a, c, b, d = m
    return dr.fma(a, d, -(b * c))


def solve(m: Matrix, right: Columns) -> Columns:
    """The vector that the matrix takes to ``right``."""
    a, c, b, d = m
    x, y = right
    scale = 1 / determinant(m)
    return [(d * x - b * y) * scale, (a * y - c * x) * scale]


def _times(m: Matrix, n: Matrix) -> Matrix:
    a, c, b, d = m
    return tuple(v for x, y in (n[:2], n[2:]) for v in (a * x + b * y, c * x + d * y))


def one(flow: DiscreteFlow, x: Columns, k: Any, shared: Columns, back: bool = False) -> Columns:
    """Step ``k`` (an integer column) from ``x``, explicitly back from its end with ``back``."""
    array = type(x[0])
    h = _width(flow, array)

    def field(x: Columns, t: Float) -> Columns:
        return flow.velocity.columns(x, t, shared)

    t, h = ((array(k) + 1) * h, -h) if back else (array(k) * h, h)
    return step(flow.solver, field, _add, x, t, h)


def one_dual(
    flow: DiscreteFlow, x: Columns, k: Any, shared: Columns, back: bool = False
) -> tuple[Columns, Matrix]:
    """:func:`one` with its derivatives."""
    array = type(x[0])
    h = _width(flow, array)

    def field(x: Columns, t: Float) -> Columns:
        return flow.velocity.push_columns(x, t, shared)

    unit = [array(1), array(0), array(0), array(1)]
    t, h = ((array(k) + 1) * h, -h) if back else (array(k) * h, h)
    out = step(flow.solver, field, _add, [*x, *unit], t, h)
    return out[:2], tuple(out[2:])


def forward(flow: DiscreteFlow, x: Columns, shared: Shared, active: Any = True) -> ColumnMoved:
    """Where ``x`` leads, the determinant of the whole map there, and its derivatives.

    Rows that are not ``active`` stay where they are, and packets of rows without an active one
    cost nothing.
    """
    if found := compiled(compiled_flow.FORWARD, flow, x, shared, active):
        return ColumnMoved(found[:2], found[2], tuple(found[3:]))
    array, shared = type(shared.columns[0]), shared.columns
    index, mask = dr.uint32_array_t(array), dr.mask_t(array)

    def body(k: Any, active: Any, x: Float, y: Float, det: Float, *whole: Float) -> tuple:
        (x, y), m = one_dual(flow, [x, y], k, shared)
        return k + 1, active, x, y, det * determinant(m), *_times(m, whole)

    count, unit = step_count(flow, array), (array(1), array(0), array(0), array(1))
    start = index(0), mask(active), *(array(v) for v in x), array(1), *unit
    _, _, x, y, det, *whole = loop(
        start, lambda k, active, *rest: active & (k < count), body, "flow"
    )
    return ColumnMoved([x, y], det, tuple(whole))


def endpoint(flow: DiscreteFlow, x: Columns, shared: Shared) -> Columns:
    """Where ``x`` leads, without a density."""
    if found := compiled(compiled_flow.ENDPOINT, flow, x, shared):
        return found
    array, shared = type(shared.columns[0]), shared.columns

    def body(k: Any, x: Float, y: Float) -> tuple:
        return k + 1, *one(flow, [x, y], k, shared)

    count = step_count(flow, array)
    start = dr.uint32_array_t(array)(0), *(array(v) for v in x)
    _, x, y = loop(start, lambda k, *rest: k < count, body, "flow")
    return [x, y]


def backward(flow: DiscreteFlow, x: Columns, shared: Shared) -> ColumnOrigin:
    """**Not** the inverse: see :meth:`DiscreteFlow.backward`; ``det`` of the map it goes back."""
    if done := compiled(compiled_flow.BACKWARD, flow, x, shared):
        return ColumnOrigin(done[:2], done[2], dr.mask_t(type(x[0]))(True))
    array, shared = type(shared.columns[0]), shared.columns

    def body(k: Any, x: Float, y: Float, det: Float) -> tuple:
        (x, y), m = one_dual(flow, [x, y], k - 1, shared, back=True)
        return k - 1, x, y, det / determinant(m)

    start = step_count(flow, array), *(array(v) for v in x), array(1)
    _, x, y, det = loop(start, lambda k, *rest: k > 0, body, "flow back")
    return ColumnOrigin([x, y], det, dr.mask_t(array)(True))


def loop(state: tuple, cond: Any, body: Any, label: str) -> tuple:
    """A loop inside one kernel."""
    return dr.while_loop(state, cond, body, mode="symbolic", label=label)
