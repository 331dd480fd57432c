"""A table on the terminal: value above its interval, split in blocks where it is too wide."""

from __future__ import annotations

import textwrap

from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from harness.analysis import numbers
from harness.report.table import Cell, Footnotes, Section, Table

_GAP = 2
"""Spaces between columns: one of the grid, one of padding; the latter goes in compact form."""
_SHADES = {"pass": "blue", "degraded": "dark_orange", "fail": "bold white on dark_orange3"}
_HEADING, _NARROW = 10, 7
"""Characters a line of a heading, and in compact form."""


def print_table(table: Table, console: Console, said: set[str]) -> None:
    """Print the brief sections within ``console.width``.

    Lines of the legend that are in ``said`` are not repeated; new ones are added to it.
    """
    notes = Footnotes.of(table)
    shown: set[int] = set()
    console.print(Text(table.title, style="bold"))
    for section in table.sections:
        if not section.brief:
            continue
        if section.title:
            console.print(Text(f"\n{section.title}", style="italic"))
        for block, compact in _fitted(table, section, notes, console.width):
            console.print(_grid(table, section, block, notes, compact))
        for cell in (cell for row in section.rows for cell in row.cells):
            if cell.missing or cell.warning:
                shown.add(notes.number(cell.missing or cell.warning))
    console.print(Text(table.caption, style="dim"))
    for line in table.legend:
        if line not in said:
            console.print(Text(line, style="dim"))
            said.add(line)
    for i, reason in enumerate(notes.reasons, 1):
        if i in shown:
            console.print(Text(f"{i}: {reason}", style="yellow"))
    console.print()


def _fitted(
    table: Table, section: Section, notes: Footnotes, width: int
) -> list[tuple[list[int], bool]]:
    """Blocks of columns, and whether intervals are printed as half-widths to save room."""
    if table.text_columns:
        return [(list(range(len(table.columns))), False)]
    full = _blocks(table, section, notes, width, compact=False)
    if len(full) == 1:
        return [(full[0], False)]
    return [(block, True) for block in _blocks(table, section, notes, width, compact=True)]


def _blocks(
    table: Table, section: Section, notes: Footnotes, width: int, compact: bool
) -> list[list[int]]:
    """Column indices, grouped so that each group fits the width beside the row labels."""
    label = max([len(row.label) for row in section.rows] + [_widest(table.corner, compact)])
    blocks: list[list[int]] = [[]]
    used = label
    for i, column in enumerate(table.columns):
        cells = [_text(row.cells[i], notes, compact) for row in section.rows]
        lines = [line for cell in cells for line in cell.plain.splitlines()]
        needed = max([len(line) for line in lines] + [_widest(column, compact)])
        needed += _GAP - compact
        if blocks[-1] and used + needed > width:
            blocks.append([])
            used = label
        blocks[-1].append(i)
        used += needed
    return blocks


def _grid(
    table: Table, section: Section, columns: list[int], notes: Footnotes, compact: bool
) -> Grid:
    grid = Grid(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    grid.padding = (0, _GAP - 1 - compact, 0, 0)
    wrap = table.text_columns
    grid.add_column(Text(table.corner), no_wrap=not wrap, overflow="fold", vertical="top")
    for i in columns:
        grid.add_column(
            Text(table.columns[i] if wrap else _broken(table.columns[i], compact)),
            justify="left" if wrap else "right",
            no_wrap=not wrap,
            overflow="fold",
        )
    for i, row in enumerate(section.rows):
        if row.summary and i:
            grid.add_section()
        label = Text(row.label, style="italic" if row.summary else "")
        grid.add_row(label, *(_text(row.cells[c], notes, compact) for c in columns))
    return grid


def _text(cell: Cell, notes: Footnotes, compact: bool) -> Text:
    if cell.missing:
        return Text(f"†{notes.number(cell.missing)}", style="yellow")
    value, interval = cell.parts
    plain = "bold green" if cell.bold else "italic" if cell.ceiling else ""
    text = Text(value, style=_SHADES.get(cell.shade, plain))
    if cell.warning:
        text.append(f"‡{notes.number(cell.warning)}", style="yellow")
    if interval:
        text.append("\n" + _said(cell, interval, compact), style="dim not bold not italic")
    return text


def _said(cell: Cell, interval: str, compact: bool) -> str:
    if compact:
        half = (cell.high - cell.low) / 2
        return "±" + numbers.plain(half, numbers.decimals_for(cell.value, cell.low, cell.high))
    return interval.replace(", ", " to " if "−" in interval else "–").strip("[]")


def _broken(heading: str, compact: bool) -> str:
    """A heading broken at spaces and after hyphens, so that its column can be narrow."""
    width = _NARROW if compact else _HEADING
    return "\n".join(textwrap.wrap(heading, width, break_long_words=False))


def _widest(heading: str, compact: bool) -> int:
    return max(len(line) for line in _broken(heading, compact).splitlines() or [""])
