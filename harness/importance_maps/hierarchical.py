"""Hierarchical sample warping: Clarberg et al. (2005), Wavelet Importance Sampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.importance_maps.slices import Slice


class Hierarchical:
    """``u`` [N, 2] -> directions, by halves: at each level rows first, then columns.

    At every level the unit square is cut in proportion to the masses of the two halves and
    either part is stretched to a half of its square, from the whole of [-1, 1]^2 down to the
    cells. Points that are close in one quadrant may come from places far apart, which is what
    makes the map discontinuous. A cell on the rim is filled in its part inside the disk.

    The slice's resolution has to be a power of two.
    """

    def __init__(self, slice_: Slice):
        n = slice_.resolution
        if n & (n - 1):
            raise ValueError(f"expected a resolution that is a power of two, not {n}")
        self._n = n
        levels = [slice_.mass]
        while len(levels[-1]) > 1:
            fine = levels[-1]
            levels.append(fine[::2, ::2] + fine[::2, 1::2] + fine[1::2, ::2] + fine[1::2, 1::2])
        # From 2 x 2 down to the cells; the 1 x 1 level decides nothing.
        self._levels = levels[-2::-1]

    def __call__(self, u: NDArray) -> NDArray:
        """Points [N, 2] of the disk for ``u`` [N, 2] in [0, 1)."""
        x, y = u[:, 0].copy(), u[:, 1].copy()
        column, row = np.zeros(len(u), int), np.zeros(len(u), int)
        for mass in self._levels:
            i, j = 2 * row, 2 * column
            low = mass[i, j] + mass[i, j + 1]
            high = mass[i + 1, j] + mass[i + 1, j + 1]
            up, y = _halve(low, high, y)
            row = i + up
            right, x = _halve(mass[row, j], mass[row, j + 1], x)
            column = j + right
        return self._in_cell(column, row, x, y)

    def _in_cell(self, column: NDArray, row: NDArray, x: NDArray, y: NDArray) -> NDArray:
        side = 2 / self._n
        left, bottom = column * side - 1, row * side - 1
        right, top = left + side, bottom + side
        # The cell's part inside the disk, row by row: first the range of y that has any.
        nearest = np.where((left < 0) & (right > 0), 0, np.minimum(np.abs(left), np.abs(right)))
        reach = np.sqrt(np.maximum(1 - nearest**2, 0))
        low, high = np.maximum(bottom, -reach), np.minimum(top, reach)
        at = low + y * (high - low)
        chord = np.sqrt(np.maximum(1 - at * at, 0))
        low, high = np.maximum(left, -chord), np.minimum(right, chord)
        return np.stack([low + x * (high - low), at], 1)


def _halve(low: NDArray, high: NDArray, u: NDArray) -> tuple[NDArray, NDArray]:
    """Which half ``u`` falls in (0 or 1), and where in it, in [0, 1)."""
    total = low + high
    cut = low / np.where(total > 0, total, 1)
    second = u >= cut
    rest = np.where(second, 1 - cut, cut)
    place = np.where(second, u - cut, u) / np.where(rest > 0, rest, 1)
    return second.astype(int), np.minimum(place, 1 - 2.0**-53)
