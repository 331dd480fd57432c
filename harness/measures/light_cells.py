"""Cells of the disk in two sizes: coarse ones, and those of them that matter in ``FINE``^2 parts.

A leaf is a cell that is not divided, or a part of one that is; its index is that of the cell, or
``CELLS`` + ``FINE``^2 (rank of the cell among the divided ones) + part. Every row divides cells of
its own, equally many. All areas are of the projected disk, which the square is mapped to with
equal areas.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, square_to_disk

COARSE, FINE, DIVIDED = 8, 4, 6
"""Coarse cells along a side, parts of one along a side, and how many cells are divided."""
CELLS, PARTS = COARSE**2, FINE**2
LEAVES = CELLS + DIVIDED * PARTS
USED = CELLS - DIVIDED + DIVIDED * PARTS
"""Leaves of a row; the indices of its divided cells stand for nothing."""


def areas(device: torch.device) -> Tensor:
    """Of each leaf [LEAVES]."""
    area = torch.full((LEAVES,), math.pi / CELLS, device=device)
    area[CELLS:] /= PARTS
    return area


def cell_of(wo: Tensor) -> Tensor:
    """Coarse cell [N] of each point [N, 2] of the disk."""
    at = (disk_to_square(wo) * COARSE).long().clamp(0, COARSE - 1)
    return at[:, 0] + COARSE * at[:, 1]


def in_cell(cell: Tensor, u: Tensor) -> Tensor:
    """The point [N, 2] at ``u`` [N, 2] of each coarse ``cell`` [N]."""
    return square_to_disk((_corner(cell, COARSE) + u) / COARSE)


@dataclass(frozen=True)
class Leaves:
    """Of N rows: ``divided`` [N, DIVIDED] cells, and the ``rank`` [N, CELLS] of each cell or -1."""

    divided: Tensor
    rank: Tensor

    @classmethod
    def of(cls, score: Tensor) -> Leaves:
        """The cells of highest ``score`` [N, CELLS] are divided."""
        divided = score.topk(DIVIDED, 1).indices
        order = torch.arange(DIVIDED, dtype=torch.int8, device=score.device)
        rank = torch.full(score.shape, -1, dtype=torch.int8, device=score.device)
        return cls(divided, rank.scatter_(1, divided, order.repeat(len(score), 1)))

    @property
    def used(self) -> Tensor:
        """Whether each index is a leaf of the row: bool [N, LEAVES], ``USED`` of each row."""
        whole = self.rank < 0
        parts = torch.ones(len(whole), LEAVES - CELLS, dtype=torch.bool, device=whole.device)
        return torch.cat([whole, parts], 1)

    def at(self, row: Tensor, wo: Tensor) -> Tensor:
        """Leaf [M] of points ``wo`` [M, 2] of rows [M]."""
        place = disk_to_square(wo).clamp(0, 1 - 2.0**-24) * COARSE
        corner = place.long()
        cell = corner[:, 0] + COARSE * corner[:, 1]
        fine = ((place - corner) * FINE).long().clamp(0, FINE - 1)
        rank = self.rank[row, cell].long()
        part = fine[:, 0] + FINE * fine[:, 1]
        return torch.where(rank < 0, cell, CELLS + PARTS * rank + part)

    def points(self, row: Tensor, leaf: Tensor, u: Tensor) -> Tensor:
        """The point [M, 2] at ``u`` [M, 2] of each ``leaf`` [M] of ``row`` [M]."""
        part = (leaf - CELLS).clamp(min=0)
        whole = leaf < CELLS
        cell = torch.where(whole, leaf, self.divided[row, part // PARTS])
        within = torch.where(whole[:, None], u, (_corner(part % PARTS, FINE) + u) / FINE)
        return in_cell(cell, within)


def spread(values: Tensor, side: int) -> Tensor:
    """Mean of each value and its neighbours, zero beyond the edge: [N, side^2] -> the same."""
    square = values.reshape(len(values), 1, side, side)
    mean = torch.nn.functional.avg_pool2d(square, 3, 1, 1, count_include_pad=True)
    return mean.reshape(len(values), -1)


def stratified(rate: Tensor, generator: torch.Generator) -> Tensor:
    """Indices of the flat ``rate``, each on average as often as it says; ascending.

    The rates one after the other make a line; of every unit of it one point is drawn, evenly.
    """
    total = rate.double().flatten().cumsum(0)
    units = math.ceil(float(total[-1]))
    # A common start for all units would meet equal rows at equal places: their errors add up.
    at = torch.arange(units) + torch.rand(units, generator=generator, dtype=torch.float64)
    at = at.to(rate.device)
    return torch.searchsorted(total, at[at < total[-1]], right=True)


def _corner(index: Tensor, side: int) -> Tensor:
    return torch.stack([index % side, index // side], 1)
