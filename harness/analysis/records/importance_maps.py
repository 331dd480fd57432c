"""How smooth importance maps are, and what bilinear interpolation makes of them."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval

METRICS = ("binned-error", "gradient-mean", "gradient-p99", "cost", "evenness")


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.importance_maps.ImportanceMaps`."""
    return Numbers(
        [
            Record(f"{name}-{n}", *mean_interval(raw.floats(name.replace("-", "_"))[:, i]), "1")
            for name in METRICS
            for i, n in enumerate(raw.arrays["resolutions"])
        ]
    )
