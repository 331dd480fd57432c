"""Intervals of shares, which lie between zero and one."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from harness.analysis.combine import Estimate

_ENDS = ("-share", "/lost", "/invalid")
"""How metrics end that are shares."""


def is_share(metric: str) -> bool:
    return metric.endswith(_ENDS)


def between(metric: str, number: Estimate) -> Estimate:
    """The number, the interval of a share cut to where shares are.

    What is cut off cannot hold the true share, so that the rest covers it as often. A value that
    is no share, which an error would make, stays as it is with its interval.
    """
    if not (is_share(metric) and number.has_interval and 0 <= number.value <= 1):
        return number
    return replace(number, low=max(number.low, 0.0), high=min(number.high, 1.0))


def between_all(frame: pd.DataFrame) -> pd.DataFrame:
    """As :func:`between`, for records; those of an earlier analysis may need it."""
    shares = frame["metric"].map(is_share) & frame["value"].between(0, 1)
    low, high = frame["ci_low"], frame["ci_high"]
    return frame.assign(
        ci_low=low.mask(shares & (low < 0), 0.0), ci_high=high.mask(shares & (high > 1), 1.0)
    )
