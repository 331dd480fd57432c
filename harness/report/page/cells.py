"""Tables as plain data: cells with their intervals, notes and trials; what is constant is a
sentence."""

from __future__ import annotations

from typing import Any

from harness.report.page.names import Names
from harness.report.page.plain import number
from harness.report.table import Cell, Footnotes, Row, Section, Table

_FEWEST = 3
"""Cells that have to be equal for a sentence in their place."""


def plain_table(table: Table, names: Names) -> dict[str, Any]:
    """``sections`` hold rows of cells; ``constant`` says what was the same everywhere."""
    sections, columns, said = without_constants(table, names)
    notes = Footnotes.of(table)
    return {
        "name": table.name,
        "title": table.title,
        "caption": table.caption,
        "corner": table.corner,
        "columns": [table.columns[i] for i in columns],
        "columnMethods": [_place(names.methods, table.columns[i]) for i in columns],
        "best": table.best,
        "words": table.text_columns,
        "legend": table.legend,
        "notes": notes.reasons,
        "constant": said,
        "sections": [_section(table, section, columns, names, notes) for section in sections],
    }


def without_constants(table: Table, names: Names) -> tuple[list[Section], list[int], list[str]]:
    """Sections and columns (by place) that say more than one thing; sentences on the others."""
    said: list[str] = []
    sections = []
    for section in table.sections:
        text = _same([cell for row in section.rows for cell in row.cells])
        if text and not table.text_columns and len(table.sections) > 1 and not _shaded(section):
            said.append(f"{section.title or table.title}: {text} everywhere.")
        else:
            sections.append(section)
    columns = []
    by_text: dict[str, list[str]] = {}
    for i, name in enumerate(table.columns):
        cells = [row.cells[i] for section in sections for row in section.rows]
        text = _same(cells)
        # A column of a suite's only method has to stay: there is nothing beside it.
        if text and not table.text_columns and len(table.columns) > 1 and not _any_shade(cells):
            by_text.setdefault(text, []).append(name)
        else:
            columns.append(i)
    if not columns:
        return sections, list(range(len(table.columns))), said
    said += [f"{', '.join(found)}: {text} everywhere." for text, found in by_text.items()]
    return sections, columns, said


def _same(cells: list[Cell]) -> str:
    """The text that all cells have; "" where they differ, or one carries a note."""
    if len(cells) < _FEWEST or any(cell.missing or cell.warning for cell in cells):
        return ""
    texts = {" ".join(part for part in cell.parts if part) for cell in cells}
    return texts.pop() if len(texts) == 1 else ""


def _shaded(section: Section) -> bool:
    return any(_any_shade(row.cells) for row in section.rows)


def _any_shade(cells: list[Cell]) -> bool:
    return any(cell.shade for cell in cells)


def _section(
    table: Table, section: Section, columns: list[int], names: Names, notes: Footnotes
) -> dict[str, Any]:
    return {
        "title": section.title,
        "brief": section.brief,
        "scene": _place(names.scenes, section.title.partition(":")[0]),
        "rows": [_row(table, section, row, columns, names, notes) for row in section.rows],
    }


def _row(
    table: Table, section: Section, row: Row, columns: list[int], names: Names, notes: Footnotes
) -> dict[str, Any]:
    material = row.material or row.label.partition(",")[0]
    made: dict[str, Any] = {
        "label": row.label,
        "material": _place(names.materials, material),
        "method": _place(names.methods, row.label),
        "cells": [
            _cell(row.cells[i], names.behind(table, section, row, table.columns[i]), notes)
            for i in columns
        ],
    }
    if row.summary:
        made["summary"] = True
    if row.about:
        made["about"] = row.about
    return made


def _cell(cell: Cell, behind: list[int], notes: Footnotes) -> dict[str, Any]:
    text, interval = cell.parts
    made: dict[str, Any] = {}
    if behind:
        made["k"] = behind
    if cell.missing:
        return made | {"no": notes.number(cell.missing) - 1}
    made["t"] = text
    if interval:
        made["i"] = interval
    for key, value in (("v", cell.value), ("l", cell.low), ("h", cell.high)):
        if value is not None and number(value) is not None:
            made[key] = number(value)
    if cell.warning:
        made["w"] = notes.number(cell.warning) - 1
    for key in ("bold", "ceiling", "biased"):
        if getattr(cell, key):
            made[key] = True
    if cell.shade:
        made["shade"] = cell.shade
    return made


def _place(names: list[str], name: str) -> int:
    return names.index(name) if name in names else -1
