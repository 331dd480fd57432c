"""A verdict on each hard case, and the worst numbers behind it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from harness.core.record import Numbers, Raw, Record

LEVELS = {"pass": 0.0, "degraded": 1.0, "fail": 2.0}
"""What is recorded for a verdict. A case that was skipped has no number, only its reason."""

NUMBERS: dict[str, tuple[str, Callable[..., float]]] = {
    "weights": ("efficiency", min),
    "coverage": ("lost", max),
    "tail-index": ("tail-index", min),
    "largest-weight": ("largest-weight", max),
    "invalid": ("invalid", max),
}
"""Property -> (metric, which of several conditions' numbers is the worst)."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.stability.Stability`."""
    records: list[Record] = []
    for case in raw.documents["findings"]["cases"]:
        if case["verdict"] in LEVELS:
            records.append(Record(case["case"], LEVELS[case["verdict"]], unit="verdict"))
        records += _worst(case)
    return Numbers(records)


def _worst(case: dict[str, Any]) -> list[Record]:
    records = []
    for name, (metric, of_several) in NUMBERS.items():
        found = [
            (float(finding["number"]), finding["unit"])
            for finding in case["findings"]
            if finding["property"] == name and finding["number"] is not None
        ]
        # A nan measures nothing: the finding fails, and that is recorded.
        values = [number for number, _ in found if not math.isnan(number)]
        if values:
            records.append(Record(f"{case['case']}/{metric}", of_several(values), unit=found[0][1]))
    return records
