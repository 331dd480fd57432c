"""How well a density follows its target: means over conditions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import Interval
from harness.stats.share import mean_share
from harness.stats.skewed_mean import SkewedMean, skewed_mean

_UNITS = {"kl": "nats", "chi2": "1", "mse": "1", "lost-share": "1", "invalid-share": "1"}
"""Arrays with a value for each condition, and their units."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.pdf.Pdf`."""
    means = {metric: _mean(metric, raw.floats(metric)) for metric in _UNITS}
    records = [
        Record(metric, *_ends(means[metric].interval), unit) for metric, unit in _UNITS.items()
    ]
    chi2, negative = raw.floats("chi2"), raw.floats("negative-share")
    return Numbers(
        [
            *records,
            Record("chi2-median", float(np.median(chi2)), unit="1"),
            Record("black-conditions", float(len(negative) - len(chi2)), unit="1"),
            Record("negative-share", float(negative.mean()), unit="1"),
            *(
                Record(f"{metric}-resolved", float(means[metric].tail != "not resolved"), unit="1")
                for metric in ("kl", "chi2")
            ),
        ]
    )


def _mean(metric: str, values: NDArray) -> SkewedMean:
    """Of a share with an interval of shares; one that is nan is no share, nor one by rounding."""
    share = metric.endswith("-share") and len(values) > 0
    if share and ((values >= 0) & (values <= 1)).all():
        return SkewedMean(mean_share(values), "not diagnosed")
    return skewed_mean(values)


def _ends(interval: Interval) -> Interval:
    """An end that nothing bounds is nan: a lower bound is left."""
    value, low, high = interval
    unbounded = math.isinf(high) and math.isfinite(value)
    return Interval(value, low, math.nan) if unbounded else interval
