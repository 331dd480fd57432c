r"""The mean of shares, each between zero and one, with an interval that stays between them.

Student's interval of a few dozen shares of which most are zero reaches below zero. Instead the
mean :math:`p` of :math:`n` shares is taken for that of as many independent yes-or-no answers as
would have its standard error :math:`e`,

.. math:: n^* = \frac{p (1 - p)}{e^2} \left(\frac{z}{t_{n-1}}\right)^2,

and has Jeffreys' interval of them: quantiles of Beta(:math:`n^* p + 1/2, n^* (1 - p) + 1/2`)
(Korn and Graubard 1998, with Jeffreys' interval in place of Clopper and Pearson's).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, ndtri, stdtrit

from harness.stats.intervals import Interval

_NORMAL = 1e8
"""With so many answers of either kind the Beta distribution is normal to 1e-4 of its width, and its
quantiles, within 1e-4 of the mean, are Student's; scipy's inverse has too few digits for them."""


def mean_share(x: ArrayLike, level: float = 0.95) -> Interval:
    """Mean of independent shares [n] in [0, 1]; where all are the same that is both ends.

    Raises:
        ValueError: no shares, or some that are none.
    """
    x = np.asarray(x, float).ravel()
    if not len(x) or not ((x >= 0) & (x <= 1)).all():
        raise ValueError(f"expected shares between 0 and 1, got {x}")
    if x.min() == x.max():
        return Interval(float(x[0]), float(x[0]), float(x[0]))
    mean, error = float(x.mean()), float(x.std(ddof=1) / np.sqrt(len(x)))
    if error**2 == 0:  # shares of 0 and of less than 1e-154: their spread is below what floats hold
        return Interval(mean, mean, mean)
    upper = (1 + level) / 2
    quantile = float(stdtrit(len(x) - 1, upper))
    answers = mean * (1 - mean) / error**2 * (float(ndtri(upper)) / quantile) ** 2
    yes, no = answers * mean + 0.5, answers * (1 - mean) + 0.5
    if min(yes, no) > _NORMAL:
        return Interval(mean, mean - quantile * error, mean + quantile * error)
    low, high = (float(betaincinv(yes, no, q)) for q in (1 - upper, upper))
    return Interval(mean, low, high)
