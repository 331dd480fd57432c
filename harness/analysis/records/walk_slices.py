"""Where light goes at a few angles, by a learned material and by the walks."""

from __future__ import annotations

import numpy as np

from harness.core.record import Numbers, Raw, Record


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.walk_slices.WalkSlices`."""
    count, mass, learned = (raw.floats(k) for k in ("count", "mass", "learned"))
    known = count.sum(-1) / raw.value("walks")
    records = []
    for i in range(len(count)):
        found = [divergence(n, m) for n, m in zip(count[i], mass[i], strict=True) if n.sum() > 0]
        if found:
            records.append(Record(f"kl-{i}", float(np.mean(found)), unit="nats"))
            ratio = float(learned[i].mean() / known[i].mean())
            records.append(Record(f"albedo-ratio-{i}", ratio, unit="1"))
    return Numbers(records)


def divergence(count: np.ndarray, mass: np.ndarray) -> float:
    """KL of counts [C] to a density of masses [C], in nats; infinite where it has none.

    Counts exceed their own distribution by (cells - 1) / (2 n) in the mean, of those cells that
    were met (Miller 1955): unbiased to first order without it.
    """
    n = count.sum()
    met = count > 0
    p, q = count[met] / n, mass[met] / mass.sum()
    if (q <= 0).any():
        return float("inf")
    return float((p * np.log(p / q)).sum() - (met.sum() - 1) / (2 * n))
