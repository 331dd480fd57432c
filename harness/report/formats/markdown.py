"""A table in GitHub's Markdown; each section is a table of its own."""

from __future__ import annotations

from harness.core.text import one_line
from harness.report.table import Cell, Footnotes, Section, Table


def markdown(table: Table) -> str:
    """The whole table: title, caption, sections, footnotes."""
    notes = Footnotes.of(table)
    blocks = [f"# {escape(table.title)}", escape(table.caption)]
    for section in table.sections:
        if section.title:
            blocks.append(f"## {escape(section.title)}")
        blocks.append(_grid(table, section, notes))
    if table.legend:
        blocks.append("\n".join(f"- {escape(line)}" for line in table.legend))
    if notes.reasons:
        lines = [f"- Note {i}: {escape(reason)}" for i, reason in enumerate(notes.reasons, 1)]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def escape(text: str) -> str:
    """Text that Markdown prints as it is."""
    for character in "\\`*_[]<>|&":
        text = text.replace(character, "\\" + character)
    return one_line(text)


def _grid(table: Table, section: Section, notes: Footnotes) -> str:
    left = ":---" if table.text_columns else "---:"
    lines = [
        _line([escape(table.corner), *(escape(c) for c in table.columns)]),
        _line([":---", *([left] * len(table.columns))]),
    ]
    for row in section.rows:
        label = f"*{escape(row.label)}*" if row.summary else escape(row.label)
        lines.append(_line([label, *(_cell(cell, notes) for cell in row.cells)]))
    return "\n".join(lines)


def _cell(cell: Cell, notes: Footnotes) -> str:
    if cell.missing:
        return f"†<sup>{notes.number(cell.missing)}</sup>"
    value, interval = (escape(part) for part in cell.parts)
    if cell.bold:
        value = f"**{value}**"
    elif cell.ceiling:
        value = f"*{value}*"
    if cell.warning:
        value += f" ‡<sup>{notes.number(cell.warning)}</sup>"
    return f"{value} {interval}".strip()


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"
