"""What a renderer does for each effect of a scene: rays, evaluations, queries."""

from __future__ import annotations

from harness.analysis.effects import MEASURE, Rows, trials
from harness.analysis.results import Results
from harness.report.table import Cell, Row, Table
from harness.report.tables.common import circumstances
from harness.report.tables.effects import ONLY_LIGHT, effect_sections

ORDER = 150
_COUNTS = {
    "rays": "rays",
    "shadow-rays": "shadow rays",
    "evaluations": "evaluations",
    "values": "values",
    "pdf-queries": "pdf queries",
    "network": "networks",
}


def effect_counts(results: Results) -> Table | str:
    """What each effect has the renderer do, in the same sections and rows."""
    found = trials(results)
    if not found:
        return f"no trial of the measure {MEASURE} is stored"
    columns = list(_COUNTS.values())
    return Table(
        name="effect-counts",
        title="What runs for each effect",
        caption=(
            "How many more, for each sample of a pixel, with the effect than without it: rays that "
            "go on from a surface, rays to a sampled light, evaluations of BSDFs, numbers that "
            "these gave, pdf queries, and evaluations of neural networks; over all surfaces. "
            + circumstances(results, MEASURE)
        ).strip(),
        corner="effect",
        columns=columns,
        sections=effect_sections(results, found, columns, _counts),
        measures=(MEASURE,),
    )


def _counts(rows: Rows, name: str) -> Row:
    cells = []
    for kind in _COUNTS:
        count = rows.get(f"{name}.{kind}")
        if count is None:
            cells.append(Cell(missing=ONLY_LIGHT))
        else:
            # A count of a few samples; its third digit is chance.
            value = round(count["value"], 2) + 0.0
            cells.append(Cell(count["value"], text=f"{value:g}"))
    return Row(name, cells)
