"""What each effect of a scene costs, what it changes, and whether the scene needs it."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record
from harness.stats.difference import difference_of, noise_of
from harness.stats.intervals import median_interval, speed_up

NEEDED, NEGLIGIBLE, MISSING, SPARE = "needed", "negligible", "missing", "not needed"
VERDICTS = (NEGLIGIBLE, NEEDED, MISSING, SPARE)
"""By the number that is recorded. The last two are of effects that the scene does not call for."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.effects.Effects`."""
    about = raw.documents["effects"]
    products = raw.floats("products")
    power = float(products.mean())
    records = [
        Record("seconds-per-spp", *median_interval(raw.floats("seconds")), "s"),
        # A half's variance is twice that of the whole, and there are two of them.
        Record("noise", 4 * noise_of(products) / power, unit="1"),
        Record("flip-noise", raw.value("flip-noise"), unit="1"),
        Record("tolerance", float(raw.settings["tolerance"]), unit="1"),
    ]
    if light := about["only_light"]:
        records += _only_light(raw, light)
    for name in about["compared"]:
        records += _compared(raw, name)
    return Numbers(records)


def _only_light(raw: Raw, name: str) -> list[Record]:
    """Without it the image is black, and nothing is rendered to find that out."""
    return [
        Record(f"{name}.relmse", 1.0, 1.0, 1.0, "1"),
        Record(f"{name}.flip", raw.value(f"{name}.flip"), unit="1"),
        Record(f"{name}.verdict", float(VERDICTS.index(NEEDED)), unit="1"),
    ]


def _compared(raw: Raw, name: str) -> list[Record]:
    """The records of one effect."""
    about, limit = raw.documents["effects"], float(raw.settings["tolerance"]) ** 2
    there = name in about["called"]
    sign = 1 if there else -1
    seconds, full_seconds = raw.floats(f"{name}.seconds"), raw.floats(f"{name}.full_seconds")
    apart = difference_of(raw.floats(f"{name}.products"), raw.value(f"{name}.power"))
    matters = apart.value.value > limit and apart.value.low > 0
    unclear = apart.value.low < limit < apart.value.high
    records = [
        Record(f"{name}.seconds", *median_interval(sign * (full_seconds - seconds)), "s"),
        Record(f"{name}.relmse", *apart.value, "1"),
        Record(f"{name}.flip", raw.value(f"{name}.flip"), unit="1"),
    ]
    if name == "emitter-sampling":
        pairs = (
            (raw.floats(f"{name}.variance"), raw.floats("variance")),
            (seconds, full_seconds),
        )
        # Without it first.
        variances, times = (pair if there else pair[::-1] for pair in pairs)
        # Where all light comes from points, the image without light sampling is black: it has no
        # noise that could be lowered, and the change of the image alone is the verdict.
        gain = speed_up(*variances, *times) if all((v > 0).all() for v in variances) else None
        if gain is not None:
            records.append(Record(f"{name}.gain", *gain, "1"))
        if gain is not None and not matters:
            matters, unclear = gain.value > 1, gain.low < 1 < gain.high
    verdict = (NEEDED if matters else NEGLIGIBLE) if there else MISSING if matters else SPARE
    records += [
        Record(f"{name}.verdict", float(VERDICTS.index(verdict)), unit="1"),
        Record(f"{name}.unclear", float(unclear), unit="1"),
    ]
    full, mine = about["counts"]["full"], about["counts"][name]
    for kind in dict.fromkeys([*mine, *full]):
        more = sign * (full.get(kind, 0.0) - mine.get(kind, 0.0))
        records.append(Record(f"{name}.{kind}", more, unit="1/sample"))
    return records
