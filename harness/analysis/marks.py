"""Which timings were disturbed, as the measures recorded it."""

from __future__ import annotations

from collections.abc import Iterable

from harness.analysis.results import SHOWN, Results
from harness.store.frame import STALE

MARK = "disturbed"
"""Metric that is 1 where the interval of a time stayed too wide, whatever was tried."""


def disturbed(
    results: Results, measures: Iterable[str], material: str, method: str, scene: str | None = None
) -> str:
    """``disturbed: ...`` where a timing of these trials is marked; "" where none is."""
    for measure in measures:
        for row in results.rows(measure, material, method, scene):
            if row["status"] in SHOWN and row["metric"] == MARK and row["value"] == 1:
                # That of a stale trial says why it is stale.
                said = "" if row["status"] == STALE else str(row["reason"])
                reason = " ".join(said.split()).partition("; ")[0]
                return reason if reason.startswith(MARK) else f"{MARK}: {reason or measure}"
    return ""
