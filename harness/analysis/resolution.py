"""When an interval is too wide for its number to be printed."""

from __future__ import annotations

from harness.analysis.combine import Estimate
from harness.analysis.numbers import plain_bound
from harness.stats.variance import WIDEST


def resolved(number: Estimate | str) -> Estimate | str:
    """A positive ``number``, or why it is none: its ends are more than ``WIDEST`` apart."""
    if isinstance(number, str) or not number.has_interval or not number.low > 0:
        return number
    if number.high <= WIDEST * number.low:
        return number
    ends = f"[{plain_bound(number.low)}, {plain_bound(number.high)}]"
    return f"not resolved: interval {ends} wider than a factor {WIDEST:g}"
