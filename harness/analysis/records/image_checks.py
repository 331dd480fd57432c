"""Do images by a method have the right mean? White furnace, reference, MIS on, off and misled."""

from __future__ import annotations

import math

from harness.core.record import Numbers, Raw, Record
from harness.stats.blocks import SIZE, Blocks
from harness.stats.intervals import ratio_of_means
from harness.stats.ztest import Agreement, agreement_of_blocks, holm

CHECKS = {
    "furnace": ("furnace", "furnace_reference"),
    "reference": ("bsdf", "reference"),
    "mis": ("mis", "bsdf"),
    "mis-reference": ("mis", "reference"),
    "tripled": ("tripled", "mis"),
    "tilted": ("tilted", "mis"),
}
"""Image and expected image of every comparison, in the order of the tables."""
RATIOS = {
    "mis-variance": ("mis", "bsdf"),
    "tripled-variance": ("tripled", "mis"),
    "tilted-variance": ("tilted", "mis"),
}
"""Images of which the variance of one sample is divided by the other's."""
ROUNDING = 2.0**-18
"""Relative error of a mean that single precision explains: some thirty roundings in a row, or
rays lost at edges between facets (one in a million). It does not average out over pixels."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.image_checks.ImageChecks`."""
    records: list[Record] = []
    for name, (image, expected) in CHECKS.items():
        records += _records(name, compare(_blocks(raw, image), _blocks(raw, expected)))
    p = [r.value for r in records if r.metric.endswith("-p")]
    records.append(Record("p", float(holm(p).min()), unit="1"))
    records += _ratios(raw)
    records.append(Record("spp", raw.value("spp"), unit="1"))
    return Numbers(records)


def compare(image: Blocks, expected: Blocks) -> Agreement:
    """``image`` against ``expected``, independent of it.

    Both may be free of noise, yet not of rounding: :data:`ROUNDING` enters as an error that a
    block's average has, so a pixel has a block's side times as much.
    """
    return agreement_of_blocks([image, expected.uncertain(ROUNDING * SIZE)])[0]


def _blocks(raw: Raw, name: str) -> Blocks:
    pixels = "furnace_pixels" if name.startswith("furnace") else "pixels"
    return Blocks.unpacked(raw.arrays[pixels], raw.arrays[f"{name}_blocks"])


def _records(name: str, found: Agreement) -> list[Record]:
    records = [
        Record(f"{name}-z", found.global_score, unit="1"),
        Record(f"{name}-p", found.p_value, unit="1"),
    ]
    # Relative to a black image nothing is a number; its p-value is there all the same.
    if math.isfinite(found.difference):
        half = 1.96 * found.difference_error
        low, high = found.difference - half, found.difference + half
        records.insert(0, Record(name, found.difference, low, high, "1"))
    return records


def _ratios(raw: Raw) -> list[Record]:
    """Variance with MIS over that without, and of misled MIS over that of MIS."""
    records = []
    for metric, names in RATIOS.items():
        over, under = (raw.floats(f"{name}_variance") for name in names)
        resolved = tuple(_resolved(raw, name) for name in names)
        if all(resolved):
            records.append(Record(metric, *ratio_of_means(over, under), "1"))
        elif any(resolved):
            # One of them is exact.
            records.append(Record(metric, math.inf if resolved[0] else 0.0, unit="1"))
    return records


def _resolved(raw: Raw, name: str) -> bool:
    """Whether the variance stands out of the rounding of the moments it is the difference of."""
    power = _blocks(raw, name).power
    return bool((raw.floats(f"{name}_variance") > ROUNDING * power).all())
