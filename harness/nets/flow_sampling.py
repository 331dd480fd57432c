"""Samples and densities of a conditional flow of the disk, over columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.nets import defensive, discrete_flow_columns, discrete_flow_inverse
from harness.nets.conditional_flow import ColumnConditioned, ConditionalFlow
from harness.nets.coupling import unit_normal_columns
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.mixture_base import ColumnMixture
from harness.nets.velocity import Shared

FELT = 2.0**-13
"""Of a base point's deviations: a shift from which the determinant is another by some 1e-4."""

Back = Callable[[DiscreteFlow, Columns, Shared], Any]
"""Where a place comes from."""


def sample(
    net: ConditionalFlow, flow: DiscreteFlow, at: ColumnConditioned, u: Columns
) -> tuple[Float, Float, Float]:
    """Directions and density ``(x, y, pdf)`` per disk area, from three uniforms.

    The rounding of the direction, which near the rim moves its place in the plane, is taken
    back to the base by the map's Jacobian: the density is the one at the rounded direction.
    Where it moves by more than ``FELT``, the map is run again from there, for its determinant.
    Not a number where a direction of the uniform share has no origin that ``invert`` found.
    """
    elsewhere, pick = outside(net, at.base, u)
    x0 = at.base.place(unit_normal_columns(u), pick)
    moved = discrete_flow_columns.forward(flow, x0, at.shared)
    wo = directions(net, at, moved.x, elsewhere, u)
    place, slope = net.place_columns(at, wo)
    origin = _taken_back(x0, place, moved)
    felt = sum(dr.square(a - b) for a, b in zip(origin, x0, strict=True)) > FELT**2
    if elsewhere is not None:
        felt &= ~elsewhere
    again = discrete_flow_columns.forward(flow, origin, at.shared, felt)
    origin = [
        dr.select(felt, a, b)
        for a, b in zip(_taken_back(origin, place, again), origin, strict=True)
    ]
    det = dr.select(felt, again.det, moved.det)
    if elsewhere is not None:
        other = discrete_flow_inverse.invert(flow, place, at.shared, elsewhere)
        det = dr.select(elsewhere, _known(other, slope), det)
        origin = [dr.select(elsewhere, a, b) for a, b in zip(other.x, origin, strict=True)]
    return *wo, _mixed(net, at.base.pdf(origin) * (slope / dr.abs(det)), wo, at.base)


def density(
    net: ConditionalFlow,
    flow: DiscreteFlow,
    at: ColumnConditioned,
    wo: Columns,
    back: Back = discrete_flow_inverse.invert,
) -> Float:
    """Density per disk area at ``wo``; not a number where ``back`` found no origin.

    By :func:`discrete_flow_inverse.invert` that of :func:`sample`.
    """
    place, slope = net.place_columns(at, wo)
    origin = back(flow, place, at.shared)
    pdf = at.base.pdf(origin.x) * (slope / dr.abs(_known(origin, slope)))
    return _mixed(net, pdf, wo, at.base)


def _known(origin: discrete_flow_columns.ColumnOrigin, slope: Float) -> Float:
    """The determinant at ``origin``; not a number where none was found."""
    # Where there is no place there is no sample, and nothing to be found.
    return dr.select(origin.found | (slope == 0), origin.det, dr.nan)


def outside(net: ConditionalFlow, base: ColumnMixture, u: Columns) -> tuple[Any, Float]:
    """Which rows are the uniform share's beside the flow (None: no such share), and the uniform
    that picks a lobe in the others."""
    share = base.share
    if net.domain == "plane" or (isinstance(share, float) and share == 0):
        return None, u[2]
    return u[2] < share, (u[2] - share) / (1 - share)


def directions(
    net: ConditionalFlow, at: ColumnConditioned, place: Columns, elsewhere: Any, u: Columns
) -> Columns:
    """Those of places; uniform ones in the rows ``elsewhere``."""
    wo = net.direction_columns(at, place)
    if elsewhere is None:
        return wo
    there = defensive.uniform_disk_columns(u)
    return [dr.select(elsewhere, a, b) for a, b in zip(there, wo, strict=True)]


def _taken_back(x: Columns, place: Columns, moved: discrete_flow_columns.ColumnMoved) -> Columns:
    """What the map takes to ``place``, which is near to where it took ``x``."""
    away = [a - b for a, b in zip(place, moved.x, strict=True)]
    shift = discrete_flow_columns.solve(moved.jacobian, away)
    return [a + b for a, b in zip(x, shift, strict=True)]


def _mixed(net: ConditionalFlow, pdf: Float, wo: Columns, base: ColumnMixture) -> Float:
    """With the uniform share, where the base does not have it."""
    return pdf if net.domain == "plane" else defensive.mixed_columns(pdf, wo, base.share)
