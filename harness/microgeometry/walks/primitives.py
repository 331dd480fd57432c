"""The primitives of one tile: affine images of a unit sphere or a unit pyramid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError

Array = NDArray[np.float64]

SHAPES = ("sphere", "ellipsoid", "pyramid")


@dataclass(frozen=True, eq=False)
class Primitives:
    """A tile [0, 1)^2 of primitives over the ground z = 0, repeated without end.

    ``shape`` is ``sphere`` (spheres and ellipsoids) or ``pyramid``; ``centre`` [N, 3] in widths of
    the tile; ``axes`` [N, 3, 3] takes the unit shape to the primitive's, about its centre: the
    unit sphere, or the unit pyramid with the base |x|, |y| <= 1, z = 0 and the apex at z = 1.
    ``tint`` [N, 3] multiplies what the micro-BSDF reflects, at most 1.
    """

    shape: str
    centre: Array
    axes: Array
    tint: Array

    def __post_init__(self) -> None:
        n = len(self.centre)
        if self.shape not in ("sphere", "pyramid") or n == 0:
            raise ValueError(f"expected spheres or pyramids, got {n} of '{self.shape}'")
        shapes = (self.centre.shape, self.axes.shape, self.tint.shape)
        if shapes != ((n, 3), (n, 3, 3), (n, 3)):
            raise ValueError(f"expected [N, 3], [N, 3, 3] and [N, 3], got {shapes}")
        if self.tint.min() < 0 or self.tint.max() > 1:
            raise ValueError("tint: expected values from 0 to 1")

    @cached_property
    def half_extent(self) -> Array:
        """Half the size [N, 3] of each primitive's box along x, y and z (for z from its centre)."""
        if self.shape == "sphere":
            return np.sqrt((self.axes**2).sum(-1))
        flat = np.abs(self.axes[:, :, :2]).sum(-1)
        return np.stack([flat[:, 0], flat[:, 1], self.axes[:, 2, 2]], -1)

    @cached_property
    def top(self) -> float:
        """Height of the highest point above the ground, in widths of the tile."""
        return float((self.centre[:, 2] + self.half_extent[:, 2]).max())

    @property
    def mean_height(self) -> float:
        """Mean height of the surface seen from above, by 512^2 points of the tile."""
        return float(self.heights(512).mean())

    def heights(self, size: int) -> Array:
        """Height [size, size] of the surface seen from above, at the texel centres."""
        at = (np.arange(size) + 0.5) / size
        found = np.zeros((size, size))
        for centre, axes, half in zip(self.centre, self.axes, self.half_extent, strict=True):
            # Texels of the primitive's box, wrapped.
            u, v = (
                np.arange(int(np.floor((c - h) * size)), int(np.ceil((c + h) * size)) + 1)
                for c, h in zip(centre[:2], half[:2], strict=True)
            )
            x, y = np.meshgrid((u + 0.5) / size - centre[0], (v + 0.5) / size - centre[1])
            rise = self._rise(np.linalg.inv(axes), x, y) + centre[2]
            index = np.ix_(v % size, u % size)
            found[index] = np.maximum(found[index], rise)
        assert found.shape == (len(at), len(at))
        return found

    def _rise(self, inverse: Array, x: Array, y: Array) -> Array:
        """Upper surface above the centre; minus infinity beside the primitive."""
        if self.shape == "pyramid":
            local = np.stack([x, y], -1) @ inverse[:2, :2].T
            rise = (1 - np.abs(local).max(-1)) / inverse[2, 2]
            return np.where(rise >= 0, rise, -np.inf)
        # |B (x, y, z)|^2 = 1 for the greater z, with the quadratic form Q = B' B.
        q = inverse.T @ inverse
        half_b = q[0, 2] * x + q[1, 2] * y
        c = q[0, 0] * x * x + 2 * q[0, 1] * x * y + q[1, 1] * y * y - 1
        root = half_b**2 - q[2, 2] * c
        return np.where(root >= 0, (np.sqrt(np.maximum(root, 0)) - half_b) / q[2, 2], -np.inf)

    def check(self) -> None:
        """Refuse primitives that are larger than the tile, or that leave no ray a way out."""
        widest = float(self.half_extent[:, :2].max())
        if widest > 0.5:
            raise InputError(
                f"size: a primitive is {2 * widest:.2f} tiles wide; expected at most one"
            )
        if self.top <= 0:
            raise InputError("sunk: all primitives lie below the ground; expected less than 1")


def turned(direction: Array, tilt: Array) -> Array:
    """Rotations [N, 3, 3] by ``direction`` [N] about z after ``tilt`` [N] about y, in radians."""
    c, s, ct, st = np.cos(direction), np.sin(direction), np.cos(tilt), np.sin(tilt)
    zero, one = np.zeros_like(c), np.ones_like(c)
    about_z = np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(-1, 3, 3)
    about_y = np.stack([ct, zero, st, zero, one, zero, -st, zero, ct], -1).reshape(-1, 3, 3)
    return about_z @ about_y
