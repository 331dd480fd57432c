r"""What a z-test would find: the smallest difference that it finds with the wanted power.

A uniform error :math:`\delta` of energy moves the score of the whole image by :math:`\delta / s`,
with s the relative standard error of the difference. At level :math:`\alpha` (two-sided) it is
found with power :math:`\beta` from :math:`\delta = (z_{1-\alpha/2} + z_\beta)\,s` on.
"""

from __future__ import annotations

from harness.stats.distributions import normal_isf

POWER = 0.95


def quantiles(level: float, power: float = POWER) -> float:
    """The sum of both normal quantiles, for the test of :mod:`harness.stats.ztest` at ``level``.

    That has two statistics, so each is held to half of the level (Sidak).
    """
    each = 1 - (1 - level) ** 0.5
    return float(normal_isf(each / 2) + normal_isf(1 - power))


def detectable(error: float, level: float, power: float = POWER) -> float:
    """The smallest relative difference that is found, of relative standard error ``error``."""
    return quantiles(level, power) * error
