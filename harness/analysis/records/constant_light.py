"""Variance under constant light by quadrature, and the part of it that no sampler can change."""

from __future__ import annotations

import math

from harness.analysis.integral import variance_of
from harness.core.record import Numbers, Raw, Record
from harness.stats.variance import RESOLVED


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.constant_light.ConstantLight`."""
    found = variance_of(raw.arrays)
    total, tail = found.total, found.total.tail
    records = [Record("variance", total.value, unit="radiance^2")]
    if total.log is not None:
        low, high = total.log.interval[1:]
        high = high if math.isfinite(high) else math.nan
        records = [Record("variance", total.value, low, high, "radiance^2")]
    if found.power > 0:
        records.append(Record("relative-variance", total.value / found.power, unit="1"))
    records.append(Record("footprint-variance", *found.footprint, "radiance^2"))
    # Of a variance that is not resolved there is no share.
    if total.value > 0 and tail in RESOLVED:
        share = (v / total.value for v in found.footprint)
        records.append(Record("footprint-share", *share, "1"))
    records.append(Record("tail-resolved", float(tail in RESOLVED), unit="1"))
    return Numbers(records, f"{tail}: {total.why}" if total.why else "")
