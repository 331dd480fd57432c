"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record
from harness.stats.blocks import Blocks
from harness.stats.intervals import mean_interval
from harness.stats.ztest import Agreement, agreement_of_blocks


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.equal_spp.EqualSpp`."""
    found = compared(raw, "")
    first = compared(raw, "first_") if "first_blocks" in raw.arrays else found
    interval = mean_interval(raw.floats("batch_variance"))
    power = Blocks.unpacked(raw.arrays["pixels"], raw.arrays["blocks"]).power
    return Numbers(
        [
            Record("variance", *interval, "radiance^2"),
            Record("relative-variance", *(v / power for v in interval), "1"),
            Record("spp", raw.value("spp"), unit="1"),
            Record("bias", found.difference, unit="1"),
            Record("bias-z", found.global_score, unit="1"),
            Record("bias-p", found.p_value, unit="1"),
            Record("first-bias-p", first.p_value, unit="1"),
        ]
    )


def compared(raw: Raw, which: str) -> Agreement:
    """The mean image against the reference; ``which`` is "" or "first_"."""
    names = (f"{which}blocks", f"{which}reference_blocks")
    images = [Blocks.unpacked(raw.arrays["pixels"], raw.arrays[name]) for name in names]
    return agreement_of_blocks(images)[0]
