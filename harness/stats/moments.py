r"""The variance of one sample, from first and second moments.

A render of ``n`` samples per pixel gives the averages :math:`m_1 = \frac1n\sum x_i` and
:math:`m_2 = \frac1n\sum x_i^2`. The unbiased variance of a single sample is

.. math:: s^2 = \frac{n}{n-1}\,(m_2 - m_1^2) .

It is the error per sample of an estimator, and needs no reference image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def one_sample_variance(first: ArrayLike, second: ArrayLike, n: ArrayLike) -> NDArray:
    """Unbiased variance of one sample, in double precision.

    ``first`` and ``second`` are the averages of ``n`` samples and of their squares, any
    shape; ``n`` > 1 broadcasts. Where the true variance is zero, rounding of the inputs can
    leave a value slightly below it (of the order of ``eps * second``); it is not cut off,
    because that would bias averages over pixels upwards.

    Raises:
        ValueError: one sample alone has no variance.
    """
    first = np.asarray(first, float)
    second = np.asarray(second, float)
    n = np.asarray(n, float)
    if np.any(n < 2):
        raise ValueError(f"a variance needs at least two samples, got {n.min():g}")
    return (second - first * first) * (n / (n - 1))


def variance_from_batches(first: ArrayLike, n: float) -> NDArray:
    """Variance of one sample from the spread of independent batch means.

    ``first`` [B, ...] are means over ``n`` samples each. Unlike :func:`one_sample_variance`
    it stays right where samples inside a batch depend on each other (stratified ones).
    """
    first = np.asarray(first, float)
    if len(first) < 2:
        raise ValueError(f"a spread of batches needs at least two, got {len(first)}")
    return first.var(axis=0, ddof=1) * n
