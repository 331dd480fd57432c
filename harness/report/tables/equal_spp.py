"""Speed-up over the baseline at equal samples."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.table import Table
from harness.report.tables.speedup import speedups

ORDER = 30


def equal_spp(results: Results) -> Table | str:
    """Speed-up at equal samples: variance of one sample of the baseline over the method's."""
    caption = (
        "Variance of one sample of {baseline} over that of the method (×, higher is better): "
        "the speed-up if sampling cost nothing."
    )
    return speedups(
        results, "equal-spp", "Improvement at equal samples", "speedup-equal-spp", caption
    )
