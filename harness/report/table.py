"""A table before it is written in any format: rows of cells, each a number or its absence."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from harness.analysis import numbers


@dataclass(frozen=True)
class Cell:
    """One entry.

    ``value`` with its 95% interval ``low``, ``high``; ``text`` replaces the printed number
    (the value stays in the CSV). ``missing`` says why there is no number: it is printed as a
    dagger with that footnote. ``warning`` is a footnote on a number that is there; ``biased``
    says that it is the number of an estimator of something else.
    ``ceiling``: shown, but takes no part in the contest for bold. ``shade``: "pass",
    "degraded" or "fail", the colour of a heat map's cell where a format has colours.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    text: str = ""
    suffix: str = ""
    missing: str = ""
    warning: str = ""
    biased: bool = False
    bold: bool = False
    ceiling: bool = False
    shade: str = ""

    def __post_init__(self) -> None:
        no_number = self.value is None or math.isnan(self.value)
        if no_number and not self.text and not self.missing:
            object.__setattr__(self, "missing", "no number: not recorded")

    @property
    def parts(self) -> tuple[str, str]:
        """(number with suffix, interval), as text; empty where missing."""
        if self.missing:
            return "", ""
        if self.text:
            return self.text, ""
        value, interval = numbers.with_interval(self.value, self.low, self.high)
        return value + self.suffix, interval


@dataclass(frozen=True)
class Row:
    """Cells after a label; ``about`` explains the label where a format has room for that.

    ``material``: what the row is of, where its label is not a material's or method's name.
    """

    label: str
    cells: list[Cell]
    summary: bool = False
    about: str = ""
    material: str = ""


@dataclass(frozen=True)
class Section:
    """Rows under one heading (a scene, a measure); ``title`` may be empty.

    ``brief``: whether the console shows it too.
    """

    title: str
    rows: list[Row]
    brief: bool = True


@dataclass
class Table:
    """A named table. ``columns`` are the headings after ``corner``, the row label's.

    ``best`` is "high", "low" or "" and decides which cell of a row may be bold. ``measures``
    are those whose trials the numbers come from.
    """

    name: str
    title: str
    caption: str
    corner: str
    columns: list[str]
    sections: list[Section]
    best: str = ""
    legend: list[str] = field(default_factory=list)
    text_columns: bool = False
    measures: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for section in self.sections:
            for row in section.rows:
                if len(row.cells) != len(self.columns):
                    raise ValueError(
                        f"table {self.name}: row {row.label!r} has {len(row.cells)} cells "
                        f"for {len(self.columns)} columns"
                    )


def embolden(cells: list[Cell], best: str) -> list[Cell]:
    """Bold the best cell ("high", "low"; "": none), if its interval lies clear of the next best's.

    Cells that are missing, ceilings, or carry a warning do not compete; nor can a number
    without an interval win. A contest needs two. A number that was disturbed or came late wins
    nothing either, but may well be the best: the winner's interval lies clear of its too.
    """
    if not best:
        return cells
    sign = {"high": -1.0, "low": 1.0}[best]
    ranked = sorted(
        (i for i, c in enumerate(cells) if _competes(c)), key=lambda i: sign * cells[i].value
    )
    if len(ranked) < 2:
        return cells
    first, others = ranked[0], ranked[1:]
    if cells[first].low is None or cells[first].high is None:
        return cells
    rivals = [cells[i] for i in others] + [c for c in cells if _uncertain(c)]
    if any(_overlap(cells[first], rival, best) for rival in rivals):
        return cells
    return [replace(c, bold=True) if i == first else c for i, c in enumerate(cells)]


def _known(cell: Cell) -> bool:
    if cell.missing or cell.ceiling or cell.value is None:
        return False
    return math.isfinite(cell.value)


def _competes(cell: Cell) -> bool:
    return _known(cell) and not cell.warning


def _uncertain(cell: Cell) -> bool:
    """Whether its number is of the right thing, though not well known."""
    return _known(cell) and bool(cell.warning) and not cell.biased


def _overlap(winner: Cell, other: Cell, best: str) -> bool:
    """Whether the intervals of the two touch; a value without interval is a point."""
    if best == "high":
        return winner.low <= (other.value if other.high is None else other.high)
    return winner.high >= (other.value if other.low is None else other.low)


@dataclass
class Footnotes:
    """Numbers the distinct reasons of a table in the order in which they appear."""

    reasons: list[str] = field(default_factory=list)

    def number(self, reason: str) -> int:
        if reason not in self.reasons:
            self.reasons.append(reason)
        return self.reasons.index(reason) + 1

    @classmethod
    def of(cls, table: Table) -> Footnotes:
        notes = cls()
        for section in table.sections:
            for row in section.rows:
                for cell in row.cells:
                    if cell.missing or cell.warning:
                        notes.number(cell.missing or cell.warning)
        return notes
