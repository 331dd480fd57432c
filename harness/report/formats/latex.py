"""A table as a LaTeX ``table`` environment (booktabs), ready to be \\input into a paper."""

from __future__ import annotations

import re
import textwrap

from harness.core.text import one_line
from harness.report.table import Cell, Footnotes, Section, Table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    # Bare, it would be taken for the optional argument of the line break before it.
    "[": "{[}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "×": r"$\times$",
    "±": r"$\pm$",
    "−": r"$-$",
    "∞": r"$\infty$",
    "·": r"$\cdot$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "χ": r"$\chi$",
    "σ": r"$\sigma$",
    "µ": r"$\mu$",
    "²": r"$^2$",
    "†": r"$^\dagger$",
    "‡": r"$^\ddagger$",
    "∥": r"$\|$",
    "…": r"\ldots{}",
    "–": "--",
    "—": "---",
}
_HEADING = 10
"""Characters a line of a heading."""
_FIT_FROM, _WIDE_FROM = 3, 7
"""Columns from which a table is shrunk if the page needs it, and spans both of two columns."""


def latex(table: Table) -> str:
    """The environment; needs ``booktabs``, and ``graphicx`` where it may have to be shrunk."""
    notes = Footnotes.of(table)
    count = len(table.columns)
    fit = count >= _FIT_FROM and not table.text_columns
    environment = "table*" if count >= _WIDE_FROM else "table"
    return "\n".join(
        [
            rf"% \usepackage[T1]{{fontenc}} \usepackage{{booktabs{',graphicx' if fit else ''}}}",
            rf"\begin{{{environment}}}[tbp]",
            r"  \centering" + (r"\footnotesize" if table.text_columns else r"\small"),
            rf"  \caption{{\textbf{{{escape(table.title)}.}} {escape(table.caption)}}}",
            rf"  \label{{tab:{re.sub('[^A-Za-z0-9-]', '-', table.name)}}}",
            *([r"  \resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"] * fit),
            rf"  \begin{{tabular}}{{@{{}}{_align(table)}@{{}}}}",
            r"    \toprule",
            "    " + _line([_heading(table.corner), *(_heading(c) for c in table.columns)]),
            *(line for section in table.sections for line in _section(section, count, notes, fit)),
            r"    \bottomrule",
            r"  \end{tabular}" + "}" * fit,
            *_below(table, notes),
            rf"\end{{{environment}}}",
            "",
        ]
    )


def _align(table: Table) -> str:
    """Column types: numbers to the right; words wrap, the last column with twice the room."""
    count = len(table.columns)
    if not table.text_columns:
        return "l" + "r" * count
    share = 0.84 / (count + 2)
    return rf"p{{{share:.3f}\linewidth}}" * count + rf"p{{{2 * share:.3f}\linewidth}}"


def _section(section: Section, count: int, notes: Footnotes, stacked: bool) -> list[str]:
    """Lines of one section: a rule, its title, its rows."""
    lines = [r"    \midrule"]
    if section.title:
        title = rf"\textit{{{escape(section.title)}}}"
        lines.append(rf"    \multicolumn{{{count + 1}}}{{@{{}}l}}{{{title}}} \\")
    for i, row in enumerate(section.rows):
        if row.summary and i and not section.rows[i - 1].summary:
            lines.append(rf"    \cmidrule{{1-{count + 1}}}")
        elif stacked and i:
            lines.append(r"    \addlinespace[1pt]")
        cells = [escape(row.label), *(_cell(cell, notes, stacked) for cell in row.cells)]
        lines.append("    " + _line(cells))
    return lines


def escape(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(character, character) for character in one_line(text))


def _heading(text: str) -> str:
    """A column heading, broken after its hyphens and spaces so that the column stays narrow."""
    parts = textwrap.wrap(text, _HEADING, break_long_words=False)
    if len(parts) < 2:
        return escape(text)
    stack = r" \\ ".join(escape(part) for part in parts)
    return rf"\shortstack{{{stack}}}"


def _cell(cell: Cell, notes: Footnotes, stacked: bool) -> str:
    if cell.missing:
        return rf"$^{{\dagger{notes.number(cell.missing)}}}$"
    value, interval = (escape(part) for part in cell.parts)
    if cell.bold:
        value = rf"\textbf{{{value}}}"
    elif cell.ceiling:
        value = rf"\textit{{{value}}}"
    if cell.warning:
        value += rf"$^{{\ddagger{notes.number(cell.warning)}}}$"
    if not interval:
        return value
    interval = rf"{{\scriptsize {interval}}}"
    if not stacked:
        return f"{value} {interval}"
    return rf"\begin{{tabular}}[t]{{@{{}}r@{{}}}}{value} \\ {interval}\end{{tabular}}"


def _below(table: Table, notes: Footnotes) -> list[str]:
    """Legend and footnotes under the rules."""
    lines = [escape(line) for line in table.legend]
    lines += [rf"$^{{{i}}}$\,{escape(reason)}" for i, reason in enumerate(notes.reasons, 1)]
    if not lines:
        return []
    body = " \\\\\n    ".join(lines)
    box = r"  \par\smallskip\parbox{\linewidth}{\footnotesize\raggedright"
    return [box, f"    {body}", r"  }"]


def _line(cells: list[str]) -> str:
    return " & ".join(cells) + r" \\"
