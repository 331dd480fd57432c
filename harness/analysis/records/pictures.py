"""Samples and error of a picture."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.pictures.Pictures`."""
    spp = int(raw.arrays["chunk_spp"].sum())
    records = [
        Record("spp-achieved", float(spp), unit="1"),
        Record("achieved-seconds", float(raw.floats("chunk_seconds").sum()), unit="s"),
    ]
    variance, power = (float(raw.floats(name)) for name in ("variance", "squared_mean"))
    if power > 0:  # a black picture has no relative error
        records.append(Record("relative-mse", variance / spp / power, unit="1"))
    return Numbers(records)
