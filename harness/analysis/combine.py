"""Numbers made of several records: over seeds, over materials, and quotients."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from harness.stats.distributions import t_quantile

Z95 = 1.959963984540054
"""Normal quantile of a two-sided 95% interval."""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95% interval; bounds are None where it has none.

    ``note`` is what a reader must know before comparing it.
    """

    value: float
    low: float | None = None
    high: float | None = None
    note: str = ""

    @property
    def has_interval(self) -> bool:
        return self.low is not None and self.high is not None


def notes(estimates: Iterable[Estimate]) -> str:
    """What is to be known of any of them, each remark once."""
    return "; ".join(dict.fromkeys(e.note for e in estimates if e.note))


def over_seeds(estimates: list[Estimate]) -> Estimate:
    """Mean over training and render seeds, with an interval that holds both spreads.

    Student's t of the seeds' values, whose spread holds the noise of measuring each. Two seeds
    tell little of it (the quantile is 12.7), three much more (4.3). Positive numbers are
    averaged by their logarithm (they are ratios, times and errors), others as they are.
    """
    count = len(estimates)
    if count == 1:
        return estimates[0]
    values = np.array([e.value for e in estimates])
    if not np.isfinite(values).all():
        return Estimate(float(values.mean()), note=notes(estimates))
    logs = _on_log_scale(estimates)
    centres = np.log(values) if logs else values
    middle = float(centres.mean())
    half = float(t_quantile(0.975, count - 1) * centres.std(ddof=1) / math.sqrt(count))
    back = math.exp if logs else float
    return Estimate(back(middle), back(middle - half), back(middle + half), notes(estimates))


def geometric_mean(estimates: list[Estimate], whole: int) -> Estimate:
    """Geometric mean of positive numbers over materials, with the measurement's interval only.

    The materials are taken as given, not as a sample of all materials. Their errors are taken
    as independent and normal on the log scale, with the standard deviation that the width of
    each interval tells, so that ``sd(log mean) = sqrt(sum sd_i^2) / n``. Where the mean lacks
    some of ``whole`` materials, its note says so.

    Raises:
        ValueError: a number is not positive and finite.
    """
    if not all(0 < e.value < math.inf for e in estimates):
        raise ValueError("no geometric mean of numbers that are not positive and finite")
    value = math.exp(sum(math.log(e.value) for e in estimates) / len(estimates))
    return _mean(estimates, whole, value, logs=True)


def arithmetic_mean(estimates: list[Estimate], whole: int) -> Estimate:
    """Mean over materials; as :func:`geometric_mean`, on the plain scale."""
    value = sum(e.value for e in estimates) / len(estimates)
    return _mean(estimates, whole, value, logs=False)


def ratio(above: Estimate, below: Estimate) -> Estimate:
    """Quotient of two independent positive numbers; intervals add on the log scale."""
    value = above.value / below.value
    pair = (above, below)
    if not all(e.has_interval and e.low > 0 for e in pair):
        return Estimate(value, note=notes(pair))
    half = Z95 * math.hypot(*(_spread(e, logs=True) for e in pair))
    return Estimate(value, value * math.exp(-half), value * math.exp(half), notes(pair))


def _mean(estimates: list[Estimate], whole: int, value: float, logs: bool) -> Estimate:
    count = len(estimates)
    few = f"mean over {count} of {whole} materials only" if count < whole else ""
    note = "; ".join(filter(None, (few, notes(estimates))))
    if not all(e.has_interval and (e.low > 0 or not logs) for e in estimates):
        return Estimate(value, note=note)
    half = Z95 * math.sqrt(sum(_spread(e, logs) ** 2 for e in estimates)) / count
    if logs:
        return Estimate(value, value * math.exp(-half), value * math.exp(half), note)
    return Estimate(value, value - half, value + half, note)


def _on_log_scale(estimates: list[Estimate]) -> bool:
    return all(e.value > 0 and (not e.has_interval or e.low > 0) for e in estimates)


def _spread(estimate: Estimate, logs: bool) -> float:
    """Standard deviation that the interval tells; 0 without one."""
    if not estimate.has_interval:
        return 0.0
    if logs:
        return (math.log(estimate.high) - math.log(estimate.low)) / (2 * Z95)
    return (estimate.high - estimate.low) / (2 * Z95)
