"""Rows of the measure ``effects`` by trial, and the verdicts among them."""

from __future__ import annotations

import math
from typing import Any

from harness.analysis.results import Results

MEASURE = "effects"
VERDICTS = ("negligible", "needed", "missing", "not needed")
"""By the number that the measure records."""

Rows = dict[str, dict[str, Any]]
"""One trial's rows by metric."""


def trials(results: Results) -> dict[tuple[str, str, str], Rows]:
    """(scene, material, method) -> rows of its first trial by metric; none where it failed."""
    found: dict[tuple[str, str, str], Rows] = {}
    for row in results.rows(MEASURE):
        rows = found.setdefault((row["scene"], row["material"], row["method"]), {})
        if row["status"] == "ok":
            rows.setdefault(row["metric"], row)
    return found


def effects_of(rows: Rows) -> list[str]:
    """Names of the effects with a verdict, in order of decreasing cost, those called for first."""
    names = [m.removesuffix(".verdict") for m in rows if m.endswith(".verdict")]

    def order(name: str) -> tuple[bool, float]:
        seconds = rows.get(f"{name}.seconds")
        return verdict(rows, name) in VERDICTS[2:], -(seconds["value"] if seconds else math.inf)

    return sorted(names, key=order)


def verdict(rows: Rows, name: str) -> str:
    """In a word."""
    return VERDICTS[int(rows[f"{name}.verdict"]["value"])]
