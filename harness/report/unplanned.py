"""What of a table the suite never asked for: left out, where a dagger would say nothing."""

from __future__ import annotations

from dataclasses import replace

from harness.analysis.results import NO_TRIAL
from harness.report.table import Cell, Section, Table


def planned_only(table: Table) -> Table:
    """``table`` without columns and rows that hold no number because no trial is planned.

    A suite may take some measures of some methods alone (``methods: [{measures: [...]}]``). A
    column or row of which anything was planned stays, with its daggers.
    """
    rows = [row for section in table.sections for row in section.rows]
    keep = [not _unplanned([row.cells[i] for row in rows]) for i in range(len(table.columns))]
    sections = [
        Section(
            section.title,
            [
                replace(row, cells=[c for c, stays in zip(row.cells, keep, strict=True) if stays])
                for row in section.rows
                if not _unplanned(row.cells)
            ],
            section.brief,
        )
        for section in table.sections
    ]
    columns = [name for name, stays in zip(table.columns, keep, strict=True) if stays]
    return replace(table, columns=columns, sections=sections)


def _unplanned(cells: list[Cell]) -> bool:
    asked = any(not cell.missing for cell in cells)
    return not asked and any(cell.missing == NO_TRIAL for cell in cells)
