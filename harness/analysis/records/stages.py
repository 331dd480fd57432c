"""Time of a neural material's two stages, beside a bare network of its decoder's size."""

from __future__ import annotations

import numpy as np

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import median_interval

BARE = ("bare", "bare,-in-chunks")
"""The bare network in its two forms, of which the faster counts."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.stages.Stages`."""
    bare = min(BARE, key=lambda name: float(np.median(raw.arrays[name])))
    records = []
    for metric, name in (("stage-1", "stage-1"), ("stage-2", "stage-2"), ("bare", bare)):
        per_million = raw.floats(name) / float(raw.settings["rows"]) * 1e6
        records.append(Record(f"{metric}-seconds", *median_interval(per_million), "s"))
    ratio = np.median(raw.floats("stage-2")) / np.median(raw.floats(bare))
    return Numbers([*records, Record("stage-2-ratio", float(ratio), unit="1")])
