"""Samples and pdf queries per second."""

from __future__ import annotations

from harness.analysis.disturbed import mark
from harness.core.record import Numbers, Raw, Record
from harness.stats.round_times import RoundTimes

OWN_TIMES = ("samples-per-second", "pdf-queries-per-second")


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.throughput.Throughput`."""
    calls = {what: per_row(raw, what) for what in ("sample", "pdf")}
    records = [Record("batch", raw.value("batch"), unit="1")]
    for times, metric in zip(calls.values(), OWN_TIMES, strict=True):
        value, low, high = times.median()
        records.append(Record(metric, 1 / value, 1 / high, 1 / low, "1/s"))
    for what, times in calls.items():
        records.append(Record(f"{what}-time-ratio", *times.ratio(), "1"))
    disturbed, reason = mark(list(calls.values()), float(raw.settings["tolerance"]))
    return Numbers([*records, disturbed], reason)


def per_row(raw: Raw, what: str) -> RoundTimes:
    """Seconds per row of ``sample`` or ``pdf``, beside the baseline's."""
    seconds = raw.floats(f"{what}_seconds") / raw.value("batch")
    rival = raw.floats(f"baseline_{what}_seconds_per_row") if raw.arrays["compared"] else None
    return RoundTimes(what, seconds, rival)
