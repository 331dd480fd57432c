"""A number in as few characters as can be, for labels inside figures."""

from __future__ import annotations

import math

from harness.analysis import numbers


def short(value: float) -> str:
    """Three significant digits at most; ∞ and † for what is not a number."""
    value = float(value)
    if math.isnan(value):
        return "†"
    if math.isinf(value):
        return "∞"
    return numbers.plain(value, max(0, numbers.decimals_for(value)))
