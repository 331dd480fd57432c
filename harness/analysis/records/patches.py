"""Renders of a material learned from walks beside those of its microgeometry."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record
from harness.stats.blocks import Blocks
from harness.stats.intervals import median_interval


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.patches.Patches`."""
    seconds, truth = raw.floats("seconds"), raw.floats("truth_seconds")
    noise, truth_noise = raw.value("variance"), raw.value("truth_variance")
    power = raw.value("power")
    return Numbers(
        [
            Record("seconds-per-spp", *median_interval(seconds), "s"),
            Record("truth-seconds-per-spp", *median_interval(truth), "s"),
            Record("noise", noise / power, unit="1"),
            Record("truth-noise", truth_noise / power, unit="1"),
            Record(
                "same-noise-time-ratio",
                *median_interval(truth * truth_noise / (seconds * noise)),
                "1",
            ),
            Record("macro-error", macro_error(raw), unit="1"),
            Record("size-bytes", raw.value("size_bytes"), unit="B"),
            Record("truth-size-bytes", raw.value("truth_size_bytes"), unit="B"),
        ]
    )


def macro_error(raw: Raw) -> float:
    """Squared difference of blocks' means over the truth's square, less what noise adds to both.

    The mean of n pixels' means, each of variance v, has the variance v / n.
    """
    pixels = raw.floats("pixels")
    there = pixels > 0
    truth, own = (Blocks.unpacked(pixels, raw.floats(k)) for k in ("blocks", "learned_blocks"))
    n = pixels[there]
    noise = truth.variance[there] / n
    both = noise + own.variance[there] / n
    error = (truth.mean[there] - own.mean[there]) ** 2 - both
    return float((n * error).sum() / (n * (truth.mean[there] ** 2 - noise)).sum())
