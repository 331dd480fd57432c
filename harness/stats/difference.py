"""How far two images are apart, with their noise taken off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

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
    n = len(d)
    power = float(np.square(np.mean(others, axis=0, dtype=float)).mean())
    if n < 3 or not power > 0:
        raise ValueError("expected three renders at least, and one image that is not black")
    axes = tuple(range(1, d.ndim))
    total, squares = d.sum(0), np.square(d).sum(0)
    value = float((np.square(total) - squares).mean()) / (n * (n - 1) * power)
    left = np.square(total - d) - (squares - np.square(d))
    left_out = left.mean(axes) / ((n - 1) * (n - 2) * power)
    error = np.sqrt((n - 1) / n * np.square(left_out - left_out.mean()).sum())
    half = float(stats.t.ppf(0.975, n - 1) * error)
    noise = float(d.var(0, ddof=1).mean()) / n / power
    return Difference(Interval(value, value - half, value + half), noise)
