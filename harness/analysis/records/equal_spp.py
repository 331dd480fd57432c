"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

import math

from harness.analysis.second_moments import other_variance
from harness.core.record import Numbers, Raw, Record
from harness.stats.blocks import Blocks
from harness.stats.intervals import Interval, mean_interval
from harness.stats.power import detectable
from harness.stats.variance import Deviations, Variance, confirmed, diagnosed
from harness.stats.ztest import Agreement, agreement_of_blocks

DOUBT = 1e-3
"""Level of the test whose power is aimed at: that of a look at one image."""
SLACK = 0.05
"""By how much the error of both images may be off from what each was rendered for."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.equal_spp.EqualSpp`."""
    found = compared(raw, "")
    first = compared(raw, "first_") if "first_blocks" in raw.arrays else found
    variance, interval = variance_of(raw)
    power = Blocks.unpacked(raw.arrays["pixels"], raw.arrays["blocks"]).power
    records = [
        Record("variance", *interval, "radiance^2"),
        Record("relative-variance", *(v / power for v in interval), "1"),
        Record("spp", raw.value("spp"), unit="1"),
        Record("bias", found.difference, unit="1"),
        Record("bias-error", found.difference_error, unit="1"),
        Record("bias-z", found.global_score, unit="1"),
        Record("bias-p", found.p_value, unit="1"),
        Record("first-bias-p", first.p_value, unit="1"),
    ]
    if variance is None:
        return Numbers(records)
    least = detectable(found.difference_error, DOUBT)
    records.append(Record("bias-detectable", least, unit="1"))
    records.append(
        Record("bias-power-reached", float(least <= raw.value("detect") * (1 + SLACK)), unit="1")
    )
    records.append(Record("tail-resolved", float(variance.tail != "not resolved"), unit="1"))
    if math.isfinite(variance.k):
        records.append(Record("tail-index", variance.k, unit="1"))
    # An error of zero over a black image is no number.
    named = ("bias-error", "bias-detectable")
    records = [r for r in records if r.metric not in named or math.isfinite(r.value)]
    said = f"{variance.tail}: {variance.why}" if variance.why else ""
    return Numbers(records, said)


def variance_of(raw: Raw) -> tuple[Variance | None, Interval]:
    """The variance of one sample with its diagnosis; None and batches alone in an older store.

    The ends that nothing bounds are nan.
    """
    batches = raw.floats("batch_variance")
    if "deviations" not in raw.arrays:
        return None, mean_interval(batches)
    found = diagnosed(float(batches.mean()), Deviations.unpacked(raw.arrays["deviations"]))
    found = confirmed(found, other_variance(raw.arrays))
    if found.log is None:
        return found, Interval(found.value, math.nan, math.nan)
    value, low, high = found.log.interval
    return found, Interval(value, low, high if math.isfinite(high) else math.nan)


def compared(raw: Raw, which: str) -> Agreement:
    """The mean image against the reference; ``which`` is "" or "first_"."""
    names = (f"{which}blocks", f"{which}reference_blocks")
    images = [Blocks.unpacked(raw.arrays["pixels"], raw.arrays[name]) for name in names]
    return agreement_of_blocks(images)[0]
