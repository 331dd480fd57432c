"""Small multiples of curves: rows are materials, columns a few methods each.

A dozen curves in one panel cannot be told apart. So a column shows a few, and among them the
baseline in each; it is named at its head, and a row has one range of values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from harness.analysis.results import MethodColumn
from harness.report.figures.ink import Ink
from harness.report.figures.log_panel import LogPanel, Range
from harness.report.figures.palette import Look
from harness.report.figures.style import LABEL, LINE, PAGE, TITLE

_LEFT, _GAP, _BETWEEN, _FOOT = 0.62, 0.1, 0.18, 0.42
"""Inches: left of the panels, between two of a column and between two columns, and below."""
_ROW = 0.13
"""Inches that a name at a column's head takes."""
_NAME = 0.17
"""Inches above a panel for its material's name."""
_TALL, _LOW, _MANY = 1.15, 0.5, 5
"""Inches that a panel is high, and where there are more materials than so many."""
_MOST = 4
"""Methods of a column beside the baseline."""
MARK = 3.2
"""Points: width of a marker on a curve."""


@dataclass(frozen=True)
class Across:
    """An x axis of every column: its title, and the range that all panels share."""

    title: str
    span: Range


def groups(methods: Sequence[MethodColumn], baseline: str) -> list[list[str]]:
    """Labels of the methods of each column, as even as can be, the baseline in each."""
    labels = [m.label for m in methods]
    others = [label for label in labels if label != baseline]
    first = [baseline] if baseline in labels else []
    if not others:
        return [first]
    count = -(-len(others) // _MOST)
    parts = np.array_split(np.arange(len(others)), count)
    return [first + [others[i] for i in part] for part in parts]


def method_grid(
    materials: Sequence[str],
    columns: Sequence[Sequence[str]],
    looks: dict[str, Look],
    across: Sequence[Across],
    y_title: str,
    y_of: Callable[[str], Range],
    draw: Callable[[Ink, LogPanel, str, Sequence[str], int], None],
) -> Ink:
    """A sheet with a panel for every material, column of methods, and x axis.

    ``y_of`` gives the range of a material's panels; ``draw`` draws into a panel the curves of a
    material and of some methods over the axis that it is told by its place in ``across``.
    """
    tall = _LOW if len(materials) > _MANY else _TALL
    wide = (PAGE - _LEFT - 0.05 - _BETWEEN * (len(columns) - 1)) / len(columns)
    panel = (wide - _GAP * (len(across) - 1)) / len(across)
    head = _ROW * max(len(group) for group in columns) + 0.08
    height = head + len(materials) * (tall + _NAME) + _FOOT
    ink = Ink(PAGE, height)
    for c, group in enumerate(columns):
        left = _LEFT + c * (wide + _BETWEEN)
        for n, label in enumerate(group):
            _name(ink, left, height - 0.04 - _ROW * (n + 0.5), label, looks[label])
        for m, material in enumerate(materials):
            bottom = height - head - (m + 1) * (tall + _NAME)
            y = y_of(material)
            for a, axis in enumerate(across):
                box = (left + a * (panel + _GAP), bottom, panel, tall)
                made = LogPanel(box, axis.span, y)
                last, first = m == len(materials) - 1, c == 0 and a == 0
                made.frame(ink, x_numbers=last, y_numbers=first)
                draw(ink, made, material, group, a)
                if last:
                    ink.text(box[0] + panel / 2, bottom - 0.3, axis.title, ha="center")
            if c == 0:
                ink.text(
                    left, bottom + tall + 0.03, material, ha="left", va="bottom", fontsize=TITLE
                )
    ink.text(0.1, (height - head + _FOOT) / 2, y_title, rotation=90, ha="center", va="center")
    return ink


def curve(ink: Ink, points: np.ndarray, look: Look, marked: bool = True, depth: float = 3) -> None:
    """A method's curve through ``points`` [P, 2] on the sheet."""
    ink.line(points, look.colour, LINE, look.dash, depth)
    if marked:
        ink.mark(points[np.isfinite(points).all(1)], look.marker, look.colour, _size(look))


def outline(at: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The band between two curves [P] as a closed line [2 P, 2]."""
    return np.concatenate([np.stack((at, low), -1), np.stack((at, high), -1)[::-1]])


def _name(ink: Ink, left: float, y: float, label: str, look: Look) -> None:
    """A method's name beside a piece of its curve."""
    curve(ink, np.array([[left, y], [left + 0.15, y]]), look, marked=False)
    ink.line(np.array([[left + 0.15, y], [left + 0.3, y]]), look.colour, LINE, look.dash)
    ink.mark(np.array([[left + 0.15, y]]), look.marker, look.colour, _size(look) + 1)
    ink.text(left + 0.36, y, label, ha="left", va="center_baseline", fontsize=LABEL)


def _size(look: Look) -> float:
    return MARK * {"*": 1.4, "P": 1.25, "X": 1.25}.get(look.marker, 1.0)
