"""How far two images are apart, with their noise taken off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.stats.distributions import t_quantile
from harness.stats.intervals import Interval


@dataclass(frozen=True)
class Difference:
    """Relative mean squared difference of two expected images.

    ``value`` with its 95 % interval has no noise in it and may be a little negative; ``noise``
    is what noise alone adds to the difference of the two mean images.
    """

    value: Interval
    noise: float


def difference(images: NDArray, others: NDArray) -> Difference:
    r"""Of B >= 3 independent renders each, [B, H, W, C], of the one and of the other.

    With D_b the differences of pairs, the mean of D_b D_c over b != c is an unbiased estimate
    of the square of the expected difference, for no sample is squared:

    .. math:: \frac{(\sum_b D_b)^2 - \sum_b D_b^2}{B\,(B-1)}

    averaged over pixels and channels, over the mean square of ``others``. The interval is the
    jackknife's, over b.
    """
    d = np.asarray(images, float) - np.asarray(others, float)
    return difference_of(products(d), power(others))


def products(images: NDArray) -> NDArray:
    """Mean over pixels and channels of X_b X_c, [B, B], of images X [B, H, W, C]."""
    flat = np.asarray(images, float).reshape(len(images), -1)
    return flat @ flat.T / flat.shape[1]


def power(images: NDArray) -> float:
    """Mean square of the mean of images [B, H, W, C]."""
    return float(np.square(np.mean(images, axis=0, dtype=float)).mean())


def noise_of(products: NDArray) -> float:
    """Variance of the mean of B images, averaged over pixels and channels."""
    n = len(products)
    return float(np.trace(products) - products.sum() / n) / (n - 1) / n


def difference_of(products: NDArray, power: float) -> Difference:
    """:func:`difference` of B renders from the ``products`` [B, B] of their D_b.

    Raises:
        ValueError: fewer than three renders, or black ``others``.
    """
    n = len(products)
    if n < 3 or not power > 0:
        raise ValueError("expected three renders at least, and one image that is not black")
    total, squares, own = products.sum(), np.trace(products), np.diag(products)
    value = float(total - squares) / (n * (n - 1) * power)
    # The same sums without one of the renders.
    left = total - 2 * products.sum(1) + own - (squares - own)
    left_out = left / ((n - 1) * (n - 2) * power)
    error = np.sqrt((n - 1) / n * np.square(left_out - left_out.mean()).sum())
    half = float(t_quantile(0.975, n - 1) * error)
    return Difference(Interval(value, value - half, value + half), noise_of(products) / power)
