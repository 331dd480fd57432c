"""How close a neural material comes to its surface: over the views of each level of detail."""

from __future__ import annotations

from harness.core.record import Numbers, Raw, Record
from harness.stats.intervals import mean_interval, median_interval

OVER_VIEWS = {"mse": median_interval, "flip": mean_interval, "ssim": mean_interval}
"""MSE is a median, for a view near the mirror direction has more of it than all others together."""
SIZES = ("network-parameters", "texture-numbers", "texture-channels")


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.levels.Levels`."""
    records = [
        Record(f"{metric}-{level}", *over(views), "1")
        for metric, over in OVER_VIEWS.items()
        for level, views in enumerate(raw.floats(metric))
    ]
    records += [Record(name, raw.value(name.replace("-", "_")), unit="1") for name in SIZES]
    return Numbers(records)
