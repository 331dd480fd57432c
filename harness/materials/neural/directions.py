"""Where a training looks: light directions for its queries, some of them where highlights are."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from harness.protocol import square_to_disk, to_direction

MIRRORED = 0.5
"""Share of queries near a mirror direction."""

SLOPES = (0.03, 0.6)
"""Deviations of the slopes that mirror, log-uniform between these."""


def draw(wi: Tensor, generator: torch.Generator, share: float = MIRRORED) -> Tensor:
    r"""Light directions [N, 2] for cameras ``wi`` [N, 2], inside the disk.

    A ``share`` of them mirrors wi at a normal :math:`(-a, -b, 1)` whose slopes are Gaussian, of
    a random deviation: at a normal-mapped glossy surface one in a hundred uniform directions
    shows a highlight, and a network that sees few learns none. The rest, and what a mirror
    throws below the horizon, is uniform on the disk. A regression's target does not depend on
    how often it is asked for.
    """
    n = len(wi)
    u = torch.rand(n, 4, generator=generator)
    z = torch.randn(n, 2, generator=generator)
    uniform = square_to_disk(u[:, :2])
    low, high = (math.log(s) for s in SLOPES)
    slope = torch.exp(low + (high - low) * u[:, 2:3]) * z
    normal = torch.nn.functional.normalize(torch.cat([slope, torch.ones(n, 1)], 1), dim=1)
    direction = to_direction(wi.cpu())
    mirrored = 2 * (direction * normal).sum(1, keepdim=True) * normal - direction
    # A little above the horizon, so that rounding does not put it on the rim.
    use = (u[:, 3:] < share) & (mirrored[:, 2:] > 1e-3)
    return torch.where(use, mirrored[:, :2], uniform).to(wi.device)
