"""How well a density follows its target: means over conditions."""

from __future__ import annotations

import numpy as np

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval

_UNITS = {"kl": "nats", "chi2": "1", "mse": "1", "lost-share": "1", "invalid-share": "1"}
"""Arrays with a value for each condition, and their units."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.pdf.Pdf`."""
    records = [
        Record(metric, *mean_interval(raw.floats(metric)), unit) for metric, unit in _UNITS.items()
    ]
    chi2, negative = raw.floats("chi2"), raw.floats("negative-share")
    return Numbers(
        [
            *records,
            Record("chi2-median", float(np.median(chi2)), unit="1"),
            Record("black-conditions", float(len(negative) - len(chi2)), unit="1"),
            Record("negative-share", float(negative.mean()), unit="1"),
        ]
    )
