"""Where a narrow lobe may hide between the points of a grid, and points that find it there.

Places are those that the material names (:meth:`Material.peaks`) and the mirrored direction.
Around each, the distance is spread evenly over its logarithm: a peak of any width between
``NEAREST`` and ``FARTHEST`` gets a fourteenth of the points for every factor of e in scale.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.checks.quadrature import hemisphere_to_square
from harness.checks.subject import Case
from harness.core.protocol.material import Material

NEAREST, FARTHEST = 2.0**-20, 2.0
"""Distances on the disk: some roundings of a coordinate, and all of the disk."""
RINGS = 24
"""Halvings of the distance at which cells of an integral begin."""


def centres(material: Material, case: Case) -> Tensor:
    """Places [K, 2] of the plane, in double precision on the CPU."""
    named = material.peaks(case.row[None])[0]
    return torch.cat([-case.row[None, -2:], named]).detach().to("cpu", torch.float64)


def rings(at: Tensor) -> NDArray:
    """Points [m, 2] of the square on rings around ``at`` [K, 2], for cells to be refined by."""
    turn = torch.arange(16, dtype=torch.float64) * (math.pi / 8)
    circle = torch.stack([turn.cos(), turn.sin()], -1)
    radius = 0.5 ** torch.arange(2, RINGS, dtype=torch.float64)
    around = (radius[:, None, None] * circle).reshape(-1, 1, 2) + at
    return hemisphere_to_square(around.reshape(-1, 2))[0]


def draw(at: Tensor, n: int, rng: np.random.Generator) -> Tensor:
    """``n`` directions [n, 2] around ``at`` [K, 2], in single precision; some off the disk."""
    u = torch.from_numpy(rng.random((n, 2)))
    radius = NEAREST * (FARTHEST / NEAREST) ** u[:, :1]
    turn = 2 * math.pi * u[:, 1]
    place = at[torch.arange(n) % len(at)]
    return (place + radius * torch.stack([turn.cos(), turn.sin()], -1)).float()


def density(at: Tensor, wo: Tensor) -> Tensor:
    """Of :func:`draw` at ``wo`` [N, 2], per disk area, [N]."""
    squared = (wo.detach().to("cpu", torch.float64)[:, None] - at).square().sum(-1)
    reached = (squared > NEAREST**2) & (squared < FARTHEST**2)
    each = 1 / (2 * math.pi * math.log(FARTHEST / NEAREST) * squared)
    return torch.where(reached, each, 0).mean(1)
