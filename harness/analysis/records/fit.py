"""Seconds of fitting and of loading, and the size of what was fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from harness.analysis.process_pooling import DISTURBED
from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import Interval, mean_interval

_SINGLE = (
    "fit-seconds data-seconds optimise-seconds bake-seconds load-seconds parameters size-bytes"
).split()
"""Metrics that are a single stored number each."""
_BUSY = 1.1
"""A fit, whose one thread never sleeps, that took this many times its processor time had to wait
for a processor: the machine was busy."""
_START = 0.05
"""Seconds in which a fit may wait for a file or a first kernel."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.fit.Fit`."""
    parts = raw.arrays.get("part_seconds", np.empty(0))
    records = [
        Record("fit-seconds", *_steady(raw.value("fit_seconds"), parts), "s"),
        Record("data-seconds", raw.value("data_seconds"), unit="s"),
        Record("optimise-seconds", *_steady(raw.value("optimise_seconds"), parts), "s"),
        Record("load-seconds", raw.value("load_seconds"), unit="s"),
        Record("parameters", raw.value("parameters"), unit="1"),
        Record("size-bytes", raw.value("size_bytes"), unit="B"),
    ]
    if bake := raw.value("bake_seconds"):
        records.append(Record("bake-seconds", bake, unit="s"))
    if "steps" in raw.arrays:
        records.append(Record("steps", raw.value("steps"), unit="1"))
    if "validation" in raw.arrays and len(raw.arrays["validation"]) > 1:
        before, last = raw.floats("validation")[-2:, 1]
        records.append(Record("kl-moved", float(abs(before - last) / abs(last)), unit="1"))
    if "loss" in raw.arrays:
        records.append(Record("final-loss", float(raw.arrays["loss"][-1]), unit="1"))
    if "cpu_seconds" not in raw.arrays:
        return Numbers(records)
    elapsed, worked = raw.value("elapsed_seconds"), raw.value("cpu_seconds")
    waited = elapsed > _BUSY * worked + _START
    records += [
        Record("cpu-seconds", worked, unit="s"),
        Record(DISTURBED, float(waited), unit="1"),
    ]
    said = f"disturbed: of {elapsed:.3g} s the fit had a processor for {worked:.3g} s"
    return Numbers(records, said if waited else "")


def raw_of(values: Mapping[str, float]) -> dict[str, NDArray]:
    """The raw arrays of a fit of which only the records' ``values`` were kept, by metric."""
    return {name.replace("-", "_"): np.array(float(values.get(name, 0))) for name in _SINGLE}


def _steady(total: float, parts: NDArray) -> Interval:
    """``total`` seconds, and how far the sum of ``parts`` [P] of it is sure."""
    if len(parts) < 2:
        return Interval(total, math.nan, math.nan)
    mean = mean_interval(parts)
    low, high = (len(parts) * (end - mean.value) for end in (mean.low, mean.high))
    return Interval(total, total + low, total + high)
