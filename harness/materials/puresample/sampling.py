"""Samples and densities of a material's flow, over columns."""

from __future__ import annotations

from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.materials.puresample.network import PureSample
from harness.nets import defensive, discrete_flow_columns
from harness.nets.conditional_flow import ColumnConditioned
from harness.nets.coupling import unit_normal_columns


def density(network: PureSample, at: ColumnConditioned, wo: Columns) -> Float:
    """Density per disk area at ``wo``: that of the very steps that sample, inverted by Newton's
    method. Not a number where no origin was found; zero off the disk in the domain ``plane``."""
    flow = network.flow
    place, slope = network.density.place_columns(at, wo)
    origin = discrete_flow_columns.invert(flow, place, at.shared)
    pdf = at.base.pdf(origin.x) * (slope / dr.abs(origin.det))
    pdf = dr.select(origin.found | (slope == 0), pdf, dr.nan)
    return _mixed(network, pdf, wo)


def published_density(network: PureSample, at: ColumnConditioned, wo: Columns) -> Float:
    """**Not** the samples' density: by explicit steps back, as PureSample takes them (section 5.1).

    For timings beside :func:`density`, and to show what the difference is.
    """
    place, slope = network.density.place_columns(at, wo)
    origin = discrete_flow_columns.backward(network.flow, place, at.shared)
    return _mixed(network, at.base.pdf(origin.x) * (slope / dr.abs(origin.det)), wo)


def sample(network: PureSample, at: ColumnConditioned, u: Columns) -> tuple[Float, Float, Float]:
    """Directions and density ``(x, y, pdf)`` per disk area, from three uniforms.

    As :class:`~harness.materials.puresample.material.PureSampleMaterial` evaluates it: the rounding
    of the direction is taken back to the base by the map's Jacobian.
    """
    net, flow = network.density, network.flow
    inside, share = net.domain == "plane", net.share
    elsewhere = None if inside or share == 0 else u[2] < share
    pick = u[2] if elsewhere is None else (u[2] - share) / (1 - share)
    start = at.base.place(unit_normal_columns(u), pick)
    moved = discrete_flow_columns.forward(flow, start, at.shared)
    wo = net.direction_columns(at, moved.x)
    if elsewhere is not None:
        there = defensive.uniform_disk_columns(u)
        wo = [dr.select(elsewhere, a, b) for a, b in zip(there, wo, strict=True)]
    place, slope = net.place_columns(at, wo)
    away = [a - b for a, b in zip(place, moved.x, strict=True)]
    shift = discrete_flow_columns.solve(moved.jacobian, away)
    origin, det = [a + b for a, b in zip(start, shift, strict=True)], moved.det
    if elsewhere is not None:
        other = discrete_flow_columns.invert(flow, place, at.shared, elsewhere)
        det = dr.select(elsewhere, other.det, det)
        origin = [dr.select(elsewhere, a, b) for a, b in zip(other.x, origin, strict=True)]
    return *wo, _mixed(network, at.base.pdf(origin) * (slope / dr.abs(det)), wo)


def _mixed(network: PureSample, pdf: Any, wo: Columns) -> Any:
    """With the uniform share, where the base does not have it."""
    net = network.density
    return pdf if net.domain == "plane" else defensive.mixed_columns(pdf, wo, net.share)
