"""How smooth an importance map is, and what becomes of it after interpolation (Figure 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.importance_maps.maps import ImportanceMap
from harness.importance_maps.slices import Slice

BINS = 32
"""Cells a side in which reconstructions are compared, unless told."""


def gradients(map_: ImportanceMap) -> NDArray:
    r"""Norm :math:`\lVert \partial\omega / \partial\xi \rVert_F` [(R - 1)^2] by differences.

    Disk coordinates over units of the square: the map of the uniform square onto the uniform
    disk of area pi has a norm of about 2.5.
    """
    n, wo = map_.resolution, map_.wo
    across = (wo[:-1, 1:] - wo[:-1, :-1]) * n
    along = (wo[1:, :-1] - wo[:-1, :-1]) * n
    return np.sqrt(np.square(across).sum(-1) + np.square(along).sum(-1)).ravel()


def histogram(wo: NDArray, bins: int = BINS) -> NDArray:
    """Share [bins, bins] of points [N, 2] in the cells of [-1, 1]^2; row y, column x."""
    cell = np.clip(((wo + 1) * (bins / 2)).astype(int), 0, bins - 1)
    counts = np.bincount(cell[:, 1] * bins + cell[:, 0], minlength=bins * bins)
    return counts.reshape(bins, bins) / len(wo)


def coarse(mass: NDArray, bins: int = BINS) -> NDArray:
    """Masses [R, R] gathered into ``bins`` x ``bins`` cells; R has to be a multiple of bins."""
    n = len(mass) // bins
    if n * bins != len(mass):
        raise ValueError(f"expected a multiple of {bins} cells a side, not {len(mass)}")
    return mass.reshape(bins, n, bins, n).sum((1, 3))


def stratified(side: int, seed: int) -> NDArray:
    """Jittered points [side^2, 2] of the unit square, one a cell."""
    rng = np.random.default_rng(seed)
    corner = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    return (corner + rng.random(corner.shape)) / side


def binned_error(
    map_: ImportanceMap, slice_: Slice, bins: int = BINS, side: int = 512, seed: int = 0
) -> float:
    """Share of the probability that lands in the wrong cell after bilinear interpolation.

    Total variation distance between the slice and ``side``^2 stratified points sent through
    the interpolated map, on ``bins``^2 cells: 0 is perfect, 1 is disjoint.
    """
    found = histogram(map_.at(stratified(side, seed)), bins)
    return float(np.abs(found - coarse(slice_.mass, bins)).sum() / 2)
