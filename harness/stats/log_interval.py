r"""A positive quantity with an interval that need not be symmetric, on a log scale.

Intervals of independent quantities are combined by the distances of their ends (MOVER; Zou and
Donner 2008): of a product of a and b, with logarithms :math:`\theta` and ends l, u,

.. math:: \theta_a + \theta_b - \sqrt{(\theta_a - l_a)^2 + (\theta_b - l_b)^2} ,

and of the other end alike. With symmetric intervals that is the square sum of standard errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.stats.intervals import Interval
from harness.stats.log_estimate import LogEstimate, Seed

Z95 = 1.959963984540054


@dataclass(frozen=True)
class LogInterval:
    """``theta`` and the distances of the ends of its 95 % interval from it.

    An end is infinitely far where nothing bounds the quantity on that side, and nan where
    nothing tells an interval.
    """

    theta: float
    below: float
    above: float

    @classmethod
    def of(cls, estimate: LogEstimate) -> LogInterval:
        """The value and interval of a :class:`LogEstimate`."""
        half = estimate.half_width(0.95)
        return cls(math.log(estimate.value), half, half)

    @classmethod
    def between(cls, value: float, low: float, high: float) -> LogInterval:
        """``low`` <= ``value`` <= ``high``, all positive; ``high`` may be infinite, ``low`` 0."""
        theta = math.log(value)
        below = math.inf if low == 0 else theta - math.log(low)
        return cls(theta, below, math.log(high) - theta)

    @property
    def interval(self) -> Interval:
        """Value and ends."""
        low, high = self.theta - self.below, self.theta + self.above
        return Interval(math.exp(self.theta), math.exp(low), _exp(high))

    @property
    def factor(self) -> float:
        """Upper end over lower end."""
        return _exp(self.below + self.above)

    def __neg__(self) -> LogInterval:
        """The reciprocal."""
        return LogInterval(-self.theta, self.above, self.below)

    def __add__(self, other: LogInterval) -> LogInterval:
        """The product of two independent quantities."""
        return LogInterval(
            self.theta + other.theta,
            math.hypot(self.below, other.below),
            math.hypot(self.above, other.above),
        )

    def __sub__(self, other: LogInterval) -> LogInterval:
        """The quotient of two independent quantities."""
        return self + (-other)

    def scaled(self, factor: float) -> LogInterval:
        """To the power of ``factor`` > 0."""
        return LogInterval(self.theta * factor, self.below * factor, self.above * factor)

    def draws(self, count: int, seed: Seed) -> NDArray:
        """``count`` values that theta may have, whose central 95 % are its interval.

        Normal on each side, with that side's width.

        Raises:
            ValueError: an end is not known.
        """
        if not (math.isfinite(self.below) and math.isfinite(self.above)):
            raise ValueError("no draws of a quantity that has no interval")
        normal = np.random.default_rng(seed).standard_normal(count) / Z95
        return self.theta + np.where(normal < 0, self.below, self.above) * normal


def geometric_mean_of(parts: Sequence[LogInterval]) -> LogInterval:
    """Of independent quantities, with the noise of measuring alone.

    Raises:
        ValueError: no values.
    """
    if not parts:
        raise ValueError("no values")
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total.scaled(1 / len(parts))


def _exp(x: float) -> float:
    return math.exp(x) if x < 700 else math.inf
