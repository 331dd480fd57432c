"""A table as tidy CSV: a line per cell, all digits, and the reason where there is no number."""

from __future__ import annotations

import csv as writer
import io
import re

from harness.core.text import printable
from harness.report.table import Cell, Table

_FORMULA = ("=", "+", "-", "@", "\t", "\n")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
HEADER = ["section", "row", "column", "value", "ci_low", "ci_high", "best", "text", "note"]


def csv(table: Table) -> str:
    """All cells; ``nan`` where there is no number, with the reason under ``note``."""
    out = io.StringIO()
    lines = writer.writer(out, lineterminator="\n")
    lines.writerow(HEADER)
    for section in table.sections:
        for row in section.rows:
            for column, cell in zip(table.columns, row.cells, strict=True):
                names = [plain(text) for text in (section.title, row.label, column)]
                lines.writerow([*names, *_fields(cell)])
    return out.getvalue()


def _fields(cell: Cell) -> list[str]:
    numbers = [
        "nan" if number is None or cell.missing else repr(float(number))
        for number in (cell.value, cell.low, cell.high)
    ]
    text = "†" if cell.missing else " ".join(part for part in cell.parts if part)
    note = cell.missing or cell.warning
    return [*numbers, "yes" if cell.bold else "no", plain(text), plain(note)]


def plain(text: str) -> str:
    """A text that no spreadsheet takes for a formula: with an apostrophe before it if need be."""
    text = printable(text)
    return f"'{text}" if text.startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text
