"""The tables, by the names a suite uses. Each takes results and gives a table, or why not."""

from __future__ import annotations

from collections.abc import Callable

from harness.analysis.results import Results
from harness.report.table import Table
from harness.report.tables.bias import bias
from harness.report.tables.breakeven import breakeven
from harness.report.tables.effects import effect_counts, effects
from harness.report.tables.image_checks import image_checks
from harness.report.tables.importance_maps import importance_maps
from harness.report.tables.levels import levels
from harness.report.tables.pdf import pdf
from harness.report.tables.ranking import ranking
from harness.report.tables.sample_weights import sample_weights
from harness.report.tables.speedup import equal_spp, table2
from harness.report.tables.stability import stability
from harness.report.tables.status import status
from harness.report.tables.table1 import table1
from harness.report.tables.timing import timing

TABLES: dict[str, Callable[[Results], Table | str]] = {
    "table1": table1,
    "table2": table2,
    "equal-spp": equal_spp,
    "pdf": pdf,
    "bias": bias,
    "timing": timing,
    "breakeven": breakeven,
    "ranking": ranking,
    "stability": stability,
    "image-checks": image_checks,
    "sample-weights": sample_weights,
    "importance-maps": importance_maps,
    "levels": levels,
    "effects": effects,
    "effect-counts": effect_counts,
    "status": status,
}
