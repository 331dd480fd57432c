"""Directions drawn from p* once, before a fit, in groups that are each spread over p* evenly."""

from __future__ import annotations

import torch
from torch import Tensor

from harness.fitting.targets import Targets, pair, resampled

GROUPS = 32
"""Groups of a condition: as many batches pass, in the mean, before it shows one again."""


class Drawn:
    """``wo`` [P, GROUPS, D, 2]: a batch takes one group of each of its conditions.

    The draws of a condition are stratified along its directions in their order; a group is every
    ``GROUPS``-th of them: its sums vary less than those of as many independent directions. A step
    of a small network takes less time than to draw its batch anew.
    """

    def __init__(self, targets: Targets, directions: int, generator: torch.Generator):
        self.condition = targets.condition
        count, drawn = GROUPS * directions, []
        for mass, wo in zip(targets.mass.split(256), targets.wo.split(256), strict=True):
            found = wo.gather(1, pair(resampled(mass, count, generator)))
            drawn.append(found.view(-1, directions, GROUPS, 2).transpose(1, 2).contiguous())
        self.wo = torch.cat(drawn)

    def batch(self, conditions: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Conditions [B, C] and directions [B, D, 2] of their p*."""
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        group = torch.randint(GROUPS, (conditions,), generator=generator)
        row, group = row.to(self.wo.device), group.to(self.wo.device)
        return self.condition[row], self.wo[row, group]
