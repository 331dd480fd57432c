"""A table as HTML; wide ones scroll inside their own frame."""

from __future__ import annotations

from html import escape

from harness.report.table import Cell, Footnotes, Section, Table


def html(table: Table) -> str:
    """A ``section`` element with heading, caption, the grids and their notes."""
    notes = Footnotes.of(table)
    anchor = escape(table.name, quote=True)
    parts = [
        f'<section class="table" id="table-{anchor}">',
        f"<h3>{escape(table.title)}</h3>",
        f"<p class=caption>{escape(table.caption)}</p>",
    ]
    for section in table.sections:
        if section.title:
            parts.append(f"<h4>{escape(section.title)}</h4>")
        parts.append(_grid(table, section, notes))
    if table.legend or notes.reasons:
        lines = [f"<li>{escape(line)}</li>" for line in table.legend]
        lines += [
            f"<li><sup>{i}</sup> {escape(reason)}</li>" for i, reason in enumerate(notes.reasons, 1)
        ]
        parts.append(f"<ul class=notes>{''.join(lines)}</ul>")
    files = " · ".join(f'<a href="{anchor}.{end}">{end}</a>' for end in ("md", "csv", "tex"))
    parts += [f"<p class=files>{files}</p>", "</section>"]
    return "\n".join(parts)


def _grid(table: Table, section: Section, notes: Footnotes) -> str:
    kind = ' class="words"' if table.text_columns else ""
    head = "".join(f"<th scope=col>{_breakable(c)}</th>" for c in [table.corner, *table.columns])
    rows = []
    for row in section.rows:
        start = "<tr class=summary>" if row.summary else "<tr>"
        cells = "".join(_cell(cell, notes) for cell in row.cells)
        title = f' title="{escape(row.about, quote=True)}"' if row.about else ""
        rows.append(f"{start}<th scope=row{title}>{escape(row.label)}</th>{cells}</tr>")
    body = "\n".join(rows)
    return (
        f'<div class="scroll" tabindex="0"><table{kind}>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>"
    )


def _cell(cell: Cell, notes: Footnotes) -> str:
    if cell.missing:
        title = escape(cell.missing, quote=True)
        number = notes.number(cell.missing)
        return f'<td class="missing" title="{title}">†<sup>{number}</sup></td>'
    value, interval = (escape(part) for part in cell.parts)
    if cell.bold:
        value = f"<b>{value}</b>"
    elif cell.ceiling:
        value = f"<i>{value}</i>"
    if cell.warning:
        title = escape(cell.warning, quote=True)
        value += (
            f'<span class="warning" title="{title}">‡<sup>{notes.number(cell.warning)}</sup></span>'
        )
    if interval:
        value += f"<small>{interval}</small>"
    shade = f' class="{escape(cell.shade, quote=True)}"' if cell.shade else ""
    return f"<td{shade}>{value}</td>"


def _breakable(heading: str) -> str:
    return escape(heading).replace("-", "-<wbr>")
