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


def mean_share(x: ArrayLike, level: float = 0.95) -> Interval:
    """Mean of independent shares [n] in [0, 1]; where all are the same that is both ends.

    Raises:
        ValueError: no shares, or some that are none.
    """
    x = np.asarray(x, float).ravel()
    if not len(x) or not ((x >= 0) & (x <= 1)).all():
        raise ValueError(f"expected shares between 0 and 1, got {x}")
    mean = float(x.mean())
    error = float(x.std(ddof=1) / np.sqrt(len(x))) if len(x) > 1 else 0.0
    if error == 0:
        return Interval(mean, mean, mean)
    upper = (1 + level) / 2
    answers = mean * (1 - mean) / error**2 * float(ndtri(upper) / stdtrit(len(x) - 1, upper)) ** 2
    yes, no = answers * mean + 0.5, answers * (1 - mean) + 0.5
    low, high = (float(betaincinv(yes, no, q)) for q in (1 - upper, upper))
    return Interval(mean, low, high)
