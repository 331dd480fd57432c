"""An importance map, and the ways to make one of a slice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError, nearest
from harness.importance_maps.hierarchical import Hierarchical
from harness.importance_maps.row_column import RowColumn
from harness.importance_maps.slices import Slice
from harness.importance_maps.transport import grid, transport

_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class ImportanceMap:
    """``wo`` [R, R, 2] and ``weight`` f/p [R, R, 3] of the centres of the unit square's cells.

    Row is ``u[1]``, column ``u[0]``. Each cell stands for 1 / R^2 of the probability.
    """

    wo: NDArray[np.float64]
    weight: NDArray[np.float64]

    @property
    def resolution(self) -> int:
        """R."""
        return len(self.wo)

    def at(self, u: NDArray) -> NDArray:
        """Directions [N, 2] at ``u`` [N, 2]: bilinear between centres, constant beyond them."""
        n = self.resolution
        at = np.clip(u * n - 0.5, 0, n - 1)
        low = np.minimum(at.astype(int), max(n - 2, 0))
        high = np.minimum(low + 1, n - 1)
        (fx, fy), (x0, y0), (x1, y1) = (at - low).T, low.T, high.T
        fx, fy = fx[:, None], fy[:, None]
        bottom = self.wo[y0, x0] * (1 - fx) + self.wo[y0, x1] * fx
        top = self.wo[y1, x0] * (1 - fx) + self.wo[y1, x1] * fx
        return bottom * (1 - fy) + top * fy


def _row_column(slice_: Slice, resolution: int) -> NDArray:
    return RowColumn(slice_)((grid(resolution) + 1) / 2)


def _hierarchical(slice_: Slice, resolution: int) -> NDArray:
    return Hierarchical(slice_)((grid(resolution) + 1) / 2)


def equal_points(slice_: Slice, count: int) -> NDArray:
    """Points [count, 2] of equal weight: row-column sampling of a lattice of golden ratio.

    Of a regular grid all points of a row would share their y, and the rows of the slice would
    get whole multiples of R points: a chi-square test rejects that.
    """
    i = np.arange(count)
    return RowColumn(slice_)(np.stack([(i * _GOLDEN + 0.5) % 1, (i + 0.5) / count], 1))


def _transported(slice_: Slice, resolution: int) -> NDArray:
    points = equal_points(slice_, resolution**2)
    return points[transport(points)]


KINDS: dict[str, Callable[[Slice, int], NDArray]] = {
    "row-column": _row_column,
    "hierarchical": _hierarchical,
    "optimal-transport": _transported,
}
"""Kinds of map: (slice, resolution) -> directions [R^2, 2] of the grid's cells."""


def checked_kind(kind: str, where: str) -> str:
    """``kind``, if there is one of that name."""
    if kind not in KINDS:
        raise InputError(f"{where}: unknown importance map '{kind}'{nearest(kind, KINDS)}")
    return kind


def make_map(slice_: Slice, resolution: int, kind: str = "optimal-transport") -> ImportanceMap:
    """The importance map of ``slice_`` with ``resolution``^2 cells.

    Raises:
        ValueError: the slice is black.
    """
    wo = KINDS[kind](slice_, resolution)
    shape = (resolution, resolution, -1)
    return ImportanceMap(wo.reshape(shape), slice_.weight(wo).reshape(shape))
