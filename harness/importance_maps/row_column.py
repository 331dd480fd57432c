"""Marginalised inverse transform sampling of a slice, on the disk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.importance_maps.slices import Slice

STRIPS = 8
"""Horizontal strips per row of cells: how finely the rim is followed."""


class RowColumn:
    """``u`` [N, 2] -> directions: ``u[1]`` chooses y by the marginal, ``u[0]`` x in that row.

    Exact for the slice's density, up to the curvature of the rim within a strip of height
    2 / (``STRIPS`` R): a strip has the widths that its middle has, and is scaled in x to the
    disk's width at each y, so that every point lies inside the disk.
    """

    def __init__(self, slice_: Slice):
        n = slice_.resolution
        self._edges = np.linspace(-1, 1, n * STRIPS + 1)
        middle = (self._edges[1:] + self._edges[:-1]) / 2
        self._chord = np.sqrt(1 - middle**2)
        cell = np.linspace(-1, 1, n + 1)
        low = np.maximum(cell[:-1], -self._chord[:, None])
        high = np.minimum(cell[1:], self._chord[:, None])
        self._low, self._length = low, np.maximum(high - low, 0)
        self._mass = slice_.density.repeat(STRIPS, 0) * self._length
        self._rows = self._mass.sum(1)
        # One cdf after another: strip k's runs from k to k + 1. Of a black one no point comes.
        self._share = self._mass / np.where(self._rows > 0, self._rows, 1)[:, None]
        rising = np.minimum(np.cumsum(self._share, 1), 1)
        self._cdf = (rising + np.arange(n * STRIPS)[:, None]).ravel()
        self._last = n - 1 - np.argmax(self._mass[:, ::-1] > 0, 1)

    def __call__(self, u: NDArray) -> NDArray:
        """Points [N, 2] of the disk for ``u`` [N, 2] in [0, 1)."""
        strip, place = _invert(self._rows, u[:, 1])
        y = self._edges[strip] + place * (self._edges[1] - self._edges[0])
        n = self._low.shape[1]
        target = u[:, 0] + strip
        # The sum of shares may end an ulp below one: the last cell with mass has what is beyond.
        column = np.searchsorted(self._cdf, target, side="right") - strip * n
        column = np.clip(column, 0, self._last[strip])
        rest = (self._cdf[strip * n + column] - target) / self._share[strip, column]
        x = self._low[strip, column] + np.clip(1 - rest, 0, 1) * self._length[strip, column]
        # Within the strip the disk's width changes with y.
        return np.stack([x * (np.sqrt(1 - y * y) / self._chord[strip]), y], 1)


def _invert(mass: NDArray, u: NDArray) -> tuple[NDArray, NDArray]:
    """Cell and place in it, in [0, 1), where the cdf of ``mass`` [R] reaches ``u`` [N]."""
    cdf = np.cumsum(mass)
    target = u * cdf[-1]
    cell = np.searchsorted(cdf, target, side="right")
    # u < 1, but u times the sum may round up to the sum: the last cell with mass has it.
    cell = np.minimum(cell, np.flatnonzero(mass)[-1])
    place = 1 - (cdf[cell] - target) / mass[cell]
    # The running sum is rounded: a place may be an ulp off its cell.
    return cell, np.clip(place, 0, 1 - 2.0**-53)
