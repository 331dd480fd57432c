"""What one sample is worth under constant light: variance and bias of its weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval, median_interval

BIASED = 3.0
"""Standard errors beyond which a condition's mean is called biased."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.sample_weights.SampleWeights`."""
    truth, mean = raw.floats("albedo"), raw.floats("mean")
    variance = raw.floats("variance")
    error2 = variance / float(raw.settings["samples"])
    off = mean / truth - 1
    squared_error = (error2 + raw.floats("albedo_error") ** 2) / truth**2
    mean_square = float((off**2 - squared_error).mean())
    biased = np.abs(off) > BIASED * np.sqrt(squared_error)
    return Numbers(
        [
            *_both("relative-variance", variance / truth**2),
            *_both("noise-free-variance", (variance - raw.floats("noise")) / truth**2),
            Record("bias", *mean_interval(off), "1"),
            # What is not positive is a mean square of zero, seen through noise.
            Record("bias-rms", mean_square**0.5 if mean_square > 0 else 0.0, unit="1"),
            Record("biased-share", float(biased.mean()), unit="1"),
        ]
    )


def _both(name: str, values: NDArray) -> list[Record]:
    return [
        Record(name, *mean_interval(values), "1"),
        Record(f"{name}-median", *median_interval(values), "1"),
    ]
