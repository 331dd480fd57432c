"""Cells of the disk that are small where a density is high, for many conditions at once.

A cell is a square of the unit square, and its image under the concentric map, which keeps areas, is
a part of the disk. A first grid of cells is evaluated at one random point each; then, some rounds
long, the cells that hold most are cut in four and their children evaluated. A round halves the size
of the cells in a peak, so that the first grid matters only if it misses a peak altogether. Where
the caller knows of a peak, the cells around it are cut first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

ROUNDS = 8
"""Of cutting: from a first grid of 32 a side down to cells of 1/8192 of the square's side."""
CUT = 64
"""Cells that are cut in a round."""
DEFENSIVE = 0.2
"""Share of uniform directions in what is drawn: f over the density has a bound, wherever f is."""

Density = Callable[[Tensor], Tensor]
"""Of points [N, M, 2] of the square, in N conditions: values [N, M], not normalised."""


@dataclass
class Quadtree:
    """L cells in each of N conditions, which cover the square.

    ``corner`` [N, L, 2] is the lower one, ``size`` [N, L] the side, ``value`` [N, L] an estimate of
    the density's mean over the cell: half that of its one point, half that of the four cells
    beside it in the same square, for one point may miss what a cell holds.
    """

    corner: Tensor
    size: Tensor
    value: Tensor

    @classmethod
    def build(
        cls, density: Density, rows: int, side: int, peaks: Tensor, generator: torch.Generator
    ) -> Quadtree:
        """From ``side``^2 cells (an even number a side); ``peaks`` [N, K, 2] points of the square.

        Peaks outside the square are none. Uniforms: two for each evaluation.
        """
        device = peaks.device
        index = torch.arange(side, device=device, dtype=torch.float32)
        grid = torch.stack(torch.meshgrid(index, index, indexing="ij"), -1) / side
        # Four cells of one square one after the other.
        grid = grid.view(side // 2, 2, side // 2, 2, 2).transpose(1, 2).reshape(1, -1, 2)
        corner = grid.expand(rows, -1, -1)
        size = torch.full_like(corner[..., 0], 1 / side)
        tree = cls(corner, size, _evaluated(density, corner, size, generator))
        for _ in range(ROUNDS):
            tree = tree._cut(density, peaks, generator)
        return tree

    def _cut(self, density: Density, peaks: Tensor, generator: torch.Generator) -> Quadtree:
        """The cells with the most mass, and those nearest to a peak, in four each.

        Those are the ones with the peak in them or less than half their size away: a peak beside a
        border is a peak of both sides.
        """
        mass = self.value * self.size.square()
        middle = self.corner + self.size[..., None] / 2
        for peak in peaks.unbind(1):
            beside = (peak[:, None] - middle).abs().amax(-1) <= self.size
            mass = torch.where(beside, torch.inf, mass)
        cut = mass.topk(min(CUT, mass.shape[1]), 1).indices
        half = self.size.gather(1, cut) / 2
        step = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]], device=half.device, dtype=half.dtype)
        at = self.corner.gather(1, cut[..., None].expand(-1, -1, 2))
        corner = (at[:, :, None] + step * half[..., None, None]).flatten(1, 2)
        size = half[..., None].expand(-1, -1, 4).flatten(1)
        value = _evaluated(density, corner, size, generator)
        # One child in its parent's place, the others behind all.
        first, rest = slice(0, None, 4), torch.arange(size.shape[1], device=size.device) % 4 > 0
        place = cut[..., None].expand(-1, -1, 2)
        return Quadtree(
            torch.cat([self.corner.scatter(1, place, corner[:, first]), corner[:, rest]], 1),
            torch.cat([self.size.scatter(1, cut, size[:, first]), size[:, rest]], 1),
            torch.cat([self.value.scatter(1, cut, value[:, first]), value[:, rest]], 1),
        )

    def draw(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Points [N, ``count``, 2] of the square, and the area [N, ``count``] each stands for.

        Drawn from the cells by their mass, a share ``DEFENSIVE`` uniformly, stratified along the
        cells in the order of a Morton curve: the area is one over ``count`` times the density
        they were drawn with, and sums over the points of area times any function have the
        expectation of its integral. Where no mass was found at all they are uniform.
        """
        order = _morton(self.corner).argsort(1)
        corner = self.corner.gather(1, order[..., None].expand(-1, -1, 2))
        size = self.size.gather(1, order)
        area = size.double().square()
        mass = area * self.value.gather(1, order)
        total = mass.sum(1, keepdim=True)
        found = mass / torch.where(total > 0, total, 1)
        share = torch.where(total > 0, (1 - DEFENSIVE) * found + DEFENSIVE * area, area)
        cdf = share.cumsum(1)
        u = torch.rand(len(share), count, generator=generator).to(cdf)
        u = (torch.arange(count, device=cdf.device) + u) / count
        # Scaled by the cdf's own end, so that rounding leaves no gap above it.
        cell = torch.searchsorted(cdf, u * cdf[:, -1:], right=True).clamp(max=cdf.shape[1] - 1)
        within = torch.rand(len(share), count, 2, generator=generator).to(size)
        side = size.gather(1, cell)
        point = corner.gather(1, cell[..., None].expand(-1, -1, 2)) + within * side[..., None]
        density = (share / area).gather(1, cell)
        return point, (1 / (count * density)).float()


def _evaluated(
    density: Density, corner: Tensor, size: Tensor, generator: torch.Generator
) -> Tensor:
    """See ``Quadtree.value``; cells of one square stand one after the other."""
    jitter = torch.rand(corner.shape, generator=generator).to(corner)
    value = density(corner + jitter * size[..., None])
    beside = value.unflatten(1, (-1, 4)).mean(-1).repeat_interleave(4, 1)
    return (value + beside) / 2


def _morton(corner: Tensor) -> Tensor:
    """Place [N, L] of points of the square on a curve along which neighbours are near."""
    x, y = (corner * (1 << 15)).int().unbind(-1)
    return _spread(x) | (_spread(y) << 1)


def _spread(bits: Tensor) -> Tensor:
    """Fifteen bits with a zero between any two."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | (bits << shift)) & mask
    return bits
