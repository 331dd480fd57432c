"""Stored results as one tidy table: a row per record, at least one per planned trial."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from harness.store.stored import COLUMNS, DAMAGED, LABELS, NOT_RUN, Stored

if TYPE_CHECKING:
    import pandas as pd

STALE = "stale"


def frame(
    planned: Iterable[Mapping[str, Any]],
    trials: Mapping[str, Stored],
    stale: Mapping[str, str],
    all: bool = False,
) -> pd.DataFrame:
    """A row per record of the ``planned`` trials, with the columns ``COLUMNS``.

    ``trials`` are the stored ones by key, ``stale`` says of some why their numbers do not hold any
    more. ``method`` is the label; ``scene`` is "" for a measure without one. A trial without a
    number has one row with ``value`` nan and the reason. Of a trial that is ``nonfinite``, only
    the rows that are so say it. The rows of a stale one keep their numbers and have that status.
    With ``all``, trials of earlier plans follow.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    seen = set()
    for row in planned:
        labels, key = {name: row[name] for name in LABELS}, row["trial"]
        seen.add(key)
        stored = trials.get(key) or Stored(key, {}, labels, "skipped", NOT_RUN)
        rows += _rows(stored, labels, stale.get(key, ""))
    if all:
        for key in sorted(trials.keys() - seen):
            rows += _rows(trials[key], trials[key].labels, stale.get(key, ""))
    table = pd.DataFrame(rows, columns=COLUMNS)
    return table.astype({"value": float, "ci_low": float, "ci_high": float})


def _rows(trial: Stored, labels: dict[str, Any], stale: str) -> list[dict[str, Any]]:
    common = {**labels, "trial": trial.hash}
    status = "error" if trial.status == DAMAGED else trial.status
    rows = []
    for record in trial.records or [_NONE]:
        fine = status == "nonfinite" and record is not _NONE and not math.isnan(record["value"])
        said = ("ok", "") if fine else (status, trial.reason)
        if stale and said[0] == "ok":
            said = (STALE, stale)
        rows.append({**common, **record, "status": said[0], "reason": said[1]})
    return rows


_NONE = {"metric": "", "value": math.nan, "ci_low": math.nan, "ci_high": math.nan, "unit": ""}
