"""Directions drawn from p* once, before a fit, in groups that are each spread over p* evenly."""

from __future__ import annotations

import torch
from torch import Tensor

from harness.core.protocol.disk import square_to_disk
from harness.fitting.targets import Targets

GROUPS = 32
"""Groups of a condition: as many batches pass, in the mean, before it shows one again."""


class Drawn:
    """``wo`` [P, GROUPS, D, 2]: a batch takes one group of each of its conditions.

    The draws of a condition are stratified along its cells in their order, and a group is every
    ``GROUPS``-th of them: its sums vary less than those of as many independent directions. A step
    of a small network takes less time than to draw its batch anew.
    """

    def __init__(self, targets: Targets, directions: int, generator: torch.Generator):
        self.condition = targets.condition
        count, n = GROUPS * directions, targets.resolution
        drawn = []
        for mass in targets.mass.flatten(1).split(256):
            cdf = mass.cumsum(1)
            u = torch.arange(count) + torch.rand(len(mass), count, generator=generator)
            u = (u / count).to(mass.device)
            # Scaled by the cdf's own end, so that rounding leaves no gap above it.
            cell = torch.searchsorted(cdf, u * cdf[:, -1:], right=True).clamp(max=n * n - 1)
            corner = torch.stack([cell // n, cell % n], -1)
            within = torch.rand(len(mass), count, 2, generator=generator).to(mass.device)
            wo = square_to_disk((corner + within) / n)
            drawn.append(wo.view(-1, directions, GROUPS, 2).transpose(1, 2).contiguous())
        self.wo = torch.cat(drawn)

    def batch(self, conditions: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Conditions [B, C] and directions [B, D, 2] of their p*."""
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        group = torch.randint(GROUPS, (conditions,), generator=generator)
        row, group = row.to(self.wo.device), group.to(self.wo.device)
        return self.condition[row], self.wo[row, group]
