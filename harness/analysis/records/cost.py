"""Seconds per sample and per render, the shares of its parts, memory, and counts."""

from __future__ import annotations

from numpy.typing import NDArray

from harness.analysis.disturbed import mark
from harness.analysis.records.throughput import per_row
from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import Interval, mean_interval, median_interval
from harness.stats.round_times import RoundTimes

OWN_TIMES = ("seconds-per-million-samples", "seconds-per-million-pdf", "seconds-per-spp")
PARTS = ("sample", "pdf", "eval")
"""What a render asks of the method and of the material."""
_FIT = ("fit-seconds", "fit-data-seconds", "fit-optimise-seconds", "fit-bake-seconds")
"""As the fit recorded them."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.cost.Cost`."""
    sample, pdf = per_row(raw, "sample"), per_row(raw, "pdf")
    rival = raw.floats("baseline_seconds") if raw.arrays["compared"] else None
    bare = RoundTimes("render", raw.floats("seconds"), rival)
    beside = raw.floats("bare_of_metered_seconds")
    metered = RoundTimes("metered render", raw.floats("metered_seconds"), beside)
    records = [
        Record("batch", raw.value("batch"), unit="1"),
        Record("seconds-per-million-samples", *_times(sample.median(), 1e6), "s"),
        Record("seconds-per-million-pdf", *_times(pdf.median(), 1e6), "s"),
        Record("sample-time-ratio", *sample.ratio(), "1"),
        Record("pdf-time-ratio", *pdf.ratio(), "1"),
        Record("seconds-per-spp", *bare.median(), "s"),
        Record("time-ratio", *bare.ratio(), "1"),
    ]
    for part, share in shares(raw).items():
        records.append(Record(f"{part}-share", *median_interval(share), "1"))
        # Of the renders that alternated with the metered ones.
        records.append(Record(f"{part}-seconds-per-spp", *median_interval(share * beside), "s"))
    over = metered.ratio()
    overhead = raw.value("wall_seconds") / raw.value("timed_seconds") - 1
    records += [
        Record("metering-overhead", *(v - 1 for v in over), "1"),
        Record("measuring-overhead", overhead, unit="1"),
    ]
    records += [Record(key, *mean_interval(value), "1/spp") for key, value in counts(raw).items()]
    for metric in _FIT:
        if (name := metric.replace("-", "_")) in raw.arrays:
            records.append(Record(metric, raw.value(name), unit="s"))
    records += _before_the_first_sample(raw)
    disturbed, reason = mark([sample, pdf, bare, metered], float(raw.settings["tolerance"]))
    no_peak = str(raw.documents.get("no_peak", ""))
    return Numbers([*records, disturbed], "; ".join(filter(None, [reason, no_peak])))


def shares(raw: Raw) -> dict[str, NDArray]:
    """Of the metered renders [rounds]: the method's part, the material's, and the rest."""
    whole = raw.floats("metered_seconds")
    spent = {part: raw.floats(f"metered_{part}_seconds") / whole for part in PARTS}
    sampling = spent["sample"] + spent["pdf"]
    return {"sampling": sampling, "material": spent["eval"], "rest": 1 - sampling - spent["eval"]}


def counts(raw: Raw) -> dict[str, NDArray]:
    """What a metered render asked for, per sample per pixel [rounds]."""
    spp = raw.value("round_spp")
    found = {
        "rays": raw.value("pixels") + raw.floats("metered_directions") / spp,
        "shading-points": raw.floats("metered_points") / spp,
    }
    for part in PARTS:
        found[f"{part}-calls"] = raw.floats(f"metered_{part}_calls") / spp
        found[f"{part}-rows"] = raw.floats(f"metered_{part}_rows") / spp
    return found


def _before_the_first_sample(raw: Raw) -> list[Record]:
    """Of the cold starts; nothing where there were none."""
    if "load_seconds" not in raw.arrays:
        return []
    records = [
        Record("load-seconds", *median_interval(raw.floats("load_seconds")), "s"),
        Record("compile-seconds", *median_interval(raw.floats("compile_seconds")), "s"),
        Record("size-bytes", raw.value("size_bytes"), unit="B"),
    ]
    if "peak_bytes" in raw.arrays:
        records.append(Record("peak-bytes", raw.value("peak_bytes"), unit="B"))
    return records


def _times(interval: Interval, factor: float) -> Interval:
    return Interval(*(factor * v for v in interval))
