"""Samples and densities of a material's flow, over columns."""

from __future__ import annotations

from harness.core.columns.bridge import Columns, Float
from harness.materials.puresample.network import PureSample
from harness.nets import discrete_flow_columns, flow_sampling
from harness.nets.conditional_flow import ColumnConditioned


def density(network: PureSample, at: ColumnConditioned, wo: Columns) -> Float:
    """Density per disk area at ``wo``: that of the very steps that sample, inverted by Newton's
    method. Not a number where no origin was found; zero off the disk in the domain ``plane``."""
    return flow_sampling.density(network.density, network.flow, at, wo)


def published_density(network: PureSample, at: ColumnConditioned, wo: Columns) -> Float:
    """**Not** the samples' density: by explicit steps back, as PureSample takes them (section 5.1).

    For timings beside :func:`density`, and to show what the difference is.
    """
    back = discrete_flow_columns.backward
    return flow_sampling.density(network.density, network.flow, at, wo, back)


def sample(network: PureSample, at: ColumnConditioned, u: Columns) -> tuple[Float, Float, Float]:
    """Directions and density ``(x, y, pdf)`` per disk area, from three uniforms."""
    return flow_sampling.sample(network.density, network.flow, at, u)
