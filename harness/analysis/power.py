"""What the tests of mean images would find."""

from __future__ import annotations

import math

from harness.analysis.bias import LEVEL, MEASURE
from harness.analysis.results import Results
from harness.stats.power import detectable

UNKNOWN = "not recorded: the error of the test, in a store of an older version"
AIM = "0.5% in constant light and 1% in others"


def detected(results: Results, material: str, method: str, scene: str, tests: int) -> float | str:
    """The smallest uniform relative error of energy found with 95 % power, or why unknown.

    At ``LEVEL`` over the number of ``tests``, the first step of Holm's correction. Of several
    seeds the test of the most power.
    """
    rows = results.rows(MEASURE, material, method, scene)
    errors = [
        float(row["value"])
        for row in rows
        if row["metric"] == "bias-error" and math.isfinite(row["value"])
    ]
    if not errors:
        known = any(row["metric"] == "bias-p" for row in rows)
        return UNKNOWN if known else results.why_missing(MEASURE, material, method, scene)
    return detectable(min(errors), LEVEL / tests)


def weak_tests(results: Results) -> list[str]:
    """Method on material in scene, of each test that was to find less than it would find."""
    rows = results.rows(MEASURE)
    return [
        f"{row['method']} on {row['material']} in {row['scene']}"
        for row in rows
        if row["metric"] == "bias-power-reached" and row["value"] == 0
    ]
