"""Speed-up over the baseline at equal time, beside the paper's Table 2."""

from __future__ import annotations

from dataclasses import replace

from harness.analysis.results import Results
from harness.report.published.neusample import neusample
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import asked_for
from harness.report.tables.speedup import speedups

ORDER = 20


def table2(results: Results) -> Table | str:
    """Speed-up at equal time: (variance x seconds per sample) of the baseline over the method's."""
    caption = (
        "The runtime that {baseline} needs for equal quality over the runtime of the method: "
        "(variance × seconds per sample) of the one over that of the other (×, higher is better)."
    )
    table = speedups(
        results, "table2", "Speed-up at equal time", "speedup-equal-time", caption, timed=True
    )
    if isinstance(table, str) or not asked_for(results, "table2"):
        return table
    return _beside_the_paper(table, results)


def _beside_the_paper(table: Table, results: Results) -> Table:
    """The table with the paper's own below, under its names of materials; nothing is mixed."""
    paper = neusample()
    columns = [paper.speed_ups(method.name) for method in results.methods]
    if not any(columns):
        return table
    absent = f"not in {paper.table2['number']} of {paper.short}"
    rows = [
        Row(
            material,
            [
                Cell(found[material], text=_as_published(found[material]), ceiling=method.ceiling)
                if found
                else Cell(missing=absent, ceiling=method.ceiling)
                for found, method in zip(columns, results.methods, strict=True)
            ],
        )
        for material in paper.table2["rows"]
    ]
    number = paper.table2["number"]
    return replace(
        table,
        sections=[*table.sections, Section(f"{paper.short}, {number}, as published", rows)],
        legend=[
            *table.legend,
            f"{paper.short}: {paper.table2['about']}. Its materials are others than ours, and it "
            f"gives no intervals. {paper.citation}.",
        ],
    )


def _as_published(value: float) -> str:
    """With the paper's own digits."""
    return "1×" if value == 1 else f"{value:.2f}×"
