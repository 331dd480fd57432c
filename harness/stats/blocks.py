"""An image by blocks of pixels: what a test of its mean needs, in a few numbers.

Moments of blocks add up to those of larger blocks and of the whole image, without the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

SIZE = 16
"""Pixels along a side of a block."""


@dataclass(frozen=True)
class Blocks:
    """Moments over the chosen pixels of each block, [By, Bx]; nan where none is chosen.

    Of a mean image m with the variance v of each pixel's mean: ``mean`` of m, ``square`` mean of
    m^2, ``variance`` mean of v, and ``spread`` standard deviation of v.
    """

    pixels: NDArray
    mean: NDArray
    square: NDArray
    variance: NDArray
    spread: NDArray

    @classmethod
    def of(cls, mean: ArrayLike, variance: ArrayLike, mask: ArrayLike, size: int = SIZE) -> Blocks:
        """Blocks of ``size``^2 pixels, of images [H, W]; ``mask`` [H, W] chooses pixels.

        Raises:
            ValueError: shapes differ, no pixel is chosen, or one of those has no finite number.
        """
        m, v = np.asarray(mean, float), np.asarray(variance, float)
        chosen = np.asarray(mask, bool)
        if not m.shape == v.shape == chosen.shape or m.ndim != 2:
            raise ValueError(f"expected images [H, W], got {m.shape}, {v.shape}, {chosen.shape}")
        if not chosen.any():
            raise ValueError("the mask chooses no pixel")
        m, v = m[chosen], v[chosen]
        if not (np.isfinite(m).all() and np.isfinite(v).all()):
            raise ValueError("means and variances must be finite where the mask chooses")
        y, x = np.nonzero(chosen)
        shape = (-(-chosen.shape[0] // size), -(-chosen.shape[1] // size))
        single = cls(np.ones_like(m), m, m * m, v, np.zeros_like(v))
        return single._grouped((y // size) * shape[1] + x // size, shape)

    def whole(self) -> Blocks:
        """All in one block [1, 1]."""
        return self.merged(max(self.pixels.shape))

    def merged(self, times: int) -> Blocks:
        """Blocks of ``times``^2 of these."""
        y, x = np.indices(self.pixels.shape) // times
        shape = (int(y.max()) + 1, int(x.max()) + 1)
        there = self.pixels > 0
        flat = Blocks(*(part[there] for part in self._parts()))
        return flat._grouped((y * shape[1] + x)[there], shape)

    def uncertain(self, relative: float) -> Blocks:
        """With an error of ``relative`` times its mean, of known size, added to every pixel."""
        return replace(self, variance=self.variance + relative**2 * self.square)

    @property
    def power(self) -> float:
        """Mean of m^2 over all chosen pixels."""
        return float(self.whole().square[0, 0])

    def packed(self) -> NDArray:
        """All but ``pixels`` [4, By, Bx]."""
        return np.stack(self._parts()[1:])

    @classmethod
    def unpacked(cls, pixels: ArrayLike, packed: ArrayLike) -> Blocks:
        """The inverse of :meth:`packed`."""
        return cls(np.asarray(pixels, float), *np.asarray(packed, float))

    def _parts(self) -> tuple[NDArray, ...]:
        return self.pixels, self.mean, self.square, self.variance, self.spread

    def _grouped(self, labels: NDArray, shape: tuple[int, int]) -> Blocks:
        """Blocks [shape] of these [n], each with the number of its block in ``labels`` [n]."""
        many = int(np.prod(shape))
        n = np.bincount(labels, self.pixels, minlength=many)

        def mean(values: NDArray) -> NDArray:
            with np.errstate(invalid="ignore"):
                return np.bincount(labels, self.pixels * values, minlength=many) / n

        variance = mean(self.variance)
        # About the new mean: a difference of squares would cancel where all v are nearly equal.
        spread = mean(self.spread**2 + (self.variance - variance[labels]) ** 2) ** 0.5
        found = (n, mean(self.mean), mean(self.square), variance, spread)
        return Blocks(*(part.reshape(shape) for part in found))
