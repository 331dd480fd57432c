"""How close a material learned from walks comes to them: energy, shape, reciprocity."""

from __future__ import annotations

import numpy as np

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval, median_interval

NEAR = 0.03
"""Relative difference of albedos that counts as near."""
_Z = 1.959964
"""Of a 95 % interval."""


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.walks.Walks`."""
    n = raw.value("walks")
    left, count, mass, learned = (raw.floats(k) for k in ("left", "count", "mass", "learned"))
    known = left / n
    records = [
        Record(f"albedo-ratio-{i}", *_ratio(known[i], learned[i], n), "1")
        for i in range(len(known))
        if known[i].sum() > 0
    ]
    some = known > 0
    off = np.abs(learned - known)[some] / known[some]
    noise = np.sqrt(known * (1 - known) / n)[some] / known[some]
    records += [
        Record("albedo-within", float((off < NEAR).mean()), unit="1"),
        Record("albedo-noise", float(np.quantile(noise, 0.95)), unit="1"),
        Record("shape-error", *median_interval(_shape_errors(count, mass, n)), "1"),
        Record("reciprocity-error", *_reciprocity(raw.floats("pairs")), "1"),
        Record("size-bytes", raw.value("size_bytes"), unit="B"),
    ]
    return Numbers(records)


def _ratio(known: np.ndarray, learned: np.ndarray, n: float) -> tuple[float, float, float]:
    """Learned over known mean albedo [K, 3] at one angle, with the interval of the walks' error."""
    mean = known.mean()
    error = np.sqrt((known * (1 - known) / n).sum()) / known.size
    ratio = float(learned.mean() / mean)
    # To first order in the error of the mean.
    half = float(_Z * ratio * error / mean)
    return ratio, ratio - half, ratio + half


def _shape_errors(count: np.ndarray, mass: np.ndarray, n: float) -> np.ndarray:
    """Relative squared error of f over cells, by direction and channel, less the walks' noise.

    The square of a cell's share has the mean p^2 + p (1 - p) / n: unbiased, what the walks' noise
    adds is taken off above and below. A value may come out a little below zero.
    """
    p = count / n
    noise = (p * (1 - p)).sum(-1) / (n - 1)
    power = np.square(p).sum(-1) - noise
    error = np.square(p - mass).sum(-1) - noise
    return (error / power)[power > 0].ravel()


def _reciprocity(f: np.ndarray) -> tuple[float, float, float]:
    """Mean absolute difference of both ways over the mean of both, with the pairs' interval."""
    mean = f.mean()
    return mean_interval(np.abs(f[:, 0] - f[:, 1]).mean(-1) / mean)
