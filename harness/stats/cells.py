"""Cells of the unit square that are fine where points are dense: a quadtree, flattened.

A leaf is an interval of Morton codes (the interleaved bits of both coordinates), so leaves
are a sorted array, and finding a point's leaf is a binary search.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEPTH = 24
"""Halvings per axis of the finest grid; as fine as single precision near one."""


class Cells:
    """Disjoint square cells that cover [0, 1]^2.

    ``start`` [n] int64 is the Morton code of each cell's lower corner, sorted; ``level`` [n]
    its depth: the side is ``2**-level``.
    """

    def __init__(self, start: NDArray, level: NDArray):
        self.start = start
        self.level = level

    def __len__(self) -> int:
        return len(self.start)

    @staticmethod
    def uniform(level: int) -> Cells:
        """The regular grid of ``4**level`` cells."""
        start = np.arange(4**level, dtype=np.int64) << (2 * (DEPTH - level))
        return Cells(start, np.full(len(start), level))

    def refined(self, points: NDArray, most: int) -> Cells:
        """These cells, split until none holds more than ``most`` of ``points`` [N, 2].

        Cells of the finest side are not split further.
        """
        codes = np.sort(morton(points))
        cells = self
        while True:
            ends = np.append(cells.start[1:], np.int64(1) << (2 * DEPTH))
            count = np.searchsorted(codes, ends) - np.searchsorted(codes, cells.start)
            full = (count > most) & (cells.level < DEPTH)
            if not full.any():
                return cells
            cells = cells.split(full)

    def split(self, chosen: NDArray) -> Cells:
        """Each cell in ``chosen`` (bool [n]) in four."""
        chosen = chosen & (self.level < DEPTH)
        quarter = np.int64(1) << (2 * (DEPTH - self.level[chosen] - 1)).astype(np.int64)
        children = self.start[chosen, None] + quarter[:, None] * np.arange(4)
        start = np.concatenate([self.start[~chosen], children.ravel()])
        level = np.concatenate([self.level[~chosen], np.repeat(self.level[chosen] + 1, 4)])
        order = np.argsort(start)
        return Cells(start[order], level[order])

    def find(self, points: NDArray) -> NDArray:
        """Index of the cell of each of ``points`` [N, 2] in [0, 1]^2."""
        return np.searchsorted(self.start, morton(points), side="right") - 1

    def count(self, points: NDArray) -> NDArray:
        """Number of ``points`` [N, 2] in each cell."""
        return np.bincount(self.find(points), minlength=len(self))

    def owner(self, finer: Cells) -> NDArray:
        """For each cell of a refinement of these, the index of the cell that holds it."""
        return np.searchsorted(self.start, finer.start, side="right") - 1

    @property
    def corner(self) -> NDArray:
        """Lower corners [n, 2]."""
        x, y = _compact(self.start), _compact(self.start >> 1)
        return np.stack([x, y], -1) * 2.0**-DEPTH

    @property
    def side(self) -> NDArray:
        """Sides [n]."""
        return 2.0**-self.level


def morton(points: NDArray) -> NDArray:
    """Morton codes [N] of ``points`` [N, 2]: interleaved bits of the coordinates, x lowest."""
    # The closed upper edge belongs to the last cell.
    grid = np.minimum((points * 2.0**DEPTH).astype(np.int64), (1 << DEPTH) - 1)
    return _spread(grid[:, 0]) | (_spread(grid[:, 1]) << 1)


def _spread(x: NDArray) -> NDArray:
    """Insert a zero bit above every bit of 32-bit numbers."""
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        x = (x | (x << shift)) & mask
    return x


def _compact(x: NDArray) -> NDArray:
    """Inverse of :func:`_spread`; bits at odd places are ignored."""
    x = x & 0x5555555555555555
    for shift, mask in (
        (1, 0x3333333333333333),
        (2, 0x0F0F0F0F0F0F0F0F),
        (4, 0x00FF00FF00FF00FF),
        (8, 0x0000FFFF0000FFFF),
        (16, 0x00000000FFFFFFFF),
    ):
        x = (x | (x >> shift)) & mask
    return x
