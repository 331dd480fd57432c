"""The heat map of numerical stability: hard cases against methods, one coloured cell each."""

from __future__ import annotations

import textwrap

from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from harness.analysis.results import Results
from harness.analysis.verdicts import MEASURE, CaseRow, Entry, case_rows, groups
from harness.report.figures.canvas import Canvas, Drawn, sheet, wrapped
from harness.report.figures.style import styled

ORDER = 80
# Blue to orange, dark only where it fails: in order also without colour vision, and in print.
_FACE = {"pass": "#c6dbef", "degraded": "#fdbe85", "fail": "#b34700", "skip": "#ffffff"}
_INK = {"pass": "#08306b", "degraded": "#1b1d21", "fail": "#ffffff", "skip": "#777777"}
_SAID = {"pass": "", "degraded": "degraded", "fail": "FAIL", "skip": ""}
_LEGEND = (
    ("pass", "pass"),
    ("degraded", "degraded: correct, with its number"),
    ("fail", "fail"),
    ("skip", "does not apply, or was not run"),
)
_ABOUT = {
    "direction": "where the given direction points",
    "lobe": "what shape the reflectance has",
    "data": "what measured reflectance and textures hold",
    "state": "what the method's networks and tables hold",
    "input": "what the method is called with",
}
"""What the groups of the catalogue are about; a group of another name goes without."""
_WORDS = (
    "eff: share of the samples that count  ·  invalid: share that is thrown away  ·  "
    "lost: share of the light never found\n"
    "tail: index of weights without variance  ·  "
    "refused: share of the samples that a refused state would misplace"
)
"""What the numbers in the cells are."""
_CELL = (0.86, 0.19)
"""Width and height of a cell, inches."""
_BLOCK = 0.26
"""Height of a group's heading, inches."""
_LETTER = 0.062
"""Width of a letter of a case's name, inches; for the room left of the cells."""
_FOOT, _KEYS = 0.52, 5.2
"""Height and width of the legend, inches."""


def heatmap(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """One figure: rows the cases of the catalogue by group, columns the methods."""
    rows = case_rows(results)
    if not rows:
        return f"no trial of the measure {MEASURE} is stored"
    with styled():
        return [_draw(results, canvas, rows)]


def _draw(results: Results, canvas: Canvas, rows: list[CaseRow]) -> Drawn:
    blocks = groups(rows)
    left = 0.2 + _LETTER * max(len(row.name) for row in rows)
    headings = [wrapped(method.label, 12) for method in results.methods]
    top = 0.1 + 0.13 * max(heading.count("\n") + 1 for heading in headings)
    width = left + _CELL[0] * len(headings) + 0.1
    height = top + _CELL[1] * len(rows) + _BLOCK * len(blocks) + _FOOT
    width = max(width, _KEYS + 0.2)
    figure, axes = sheet(width, height)
    for i, heading in enumerate(headings):
        axes.text(
            left + (i + 0.5) * _CELL[0], height - top + 0.04, heading, ha="center", va="bottom",
            fontsize=7, linespacing=1.1,
        )  # fmt: skip
    y = height - top
    for title, members in blocks.items():
        y -= _BLOCK
        words = axes.annotate(
            title, (left, y + 0.05), ha="left", va="bottom", fontsize=7.5, weight="bold"
        )
        axes.annotate(
            _ABOUT.get(title, ""), (1, 0), xytext=(5, 0), xycoords=words,
            textcoords="offset points", ha="left", va="bottom", fontsize=7, color="#555555",
        )  # fmt: skip
        for row in members:
            y -= _CELL[1]
            axes.text(left - 0.07, y + _CELL[1] / 2, row.name, ha="right", va="center", fontsize=7)
            for i, entry in enumerate(row.entries):
                _cell(axes, left + i * _CELL[0], y, entry)
    figure.legend(
        handles=[_key(verdict, said) for verdict, said in _LEGEND],
        loc="lower left",
        bbox_to_anchor=(min(left, width - _KEYS) / width, 0.26 / height),
        ncols=len(_LEGEND),
        borderpad=0.6,
        borderaxespad=0.0,
        fontsize=7,
        columnspacing=1.2,
    )
    figure.text(
        (min(left, width - _KEYS) + 0.06) / width, 0.03 / height, _WORDS,
        ha="left", va="bottom", fontsize=6.2, color="#555555", linespacing=1.35,
    )  # fmt: skip
    return canvas.save(
        figure,
        "heatmap",
        "Numerical stability at a glance",
        "What becomes of each method in each hard case of the catalogue. Degraded: its samples and "
        "its density are right, yet by construction it cannot do the case well, and the number "
        "says how badly. Hatched: does not apply, or was not run; the table of numerical stability "
        "gives the reasons.",
    )


def _cell(axes: Axes, x: float, y: float, entry: Entry) -> None:
    axes.add_patch(
        Rectangle(
            (x, y), *_CELL, fc=_FACE[entry.verdict], ec="white", lw=0.8,
        )
    )  # fmt: skip
    if entry.verdict == "skip":
        # On its own, within the white border: hatching takes the colour of the edge.
        inset = 0.015
        axes.add_patch(
            Rectangle(
                (x + inset, y + inset), _CELL[0] - 2 * inset, _CELL[1] - 2 * inset,
                fc="white", ec="#c4c4c4", lw=0, hatch="//////",
            )
        )  # fmt: skip
        return
    said = textwrap.shorten(entry.short or _SAID[entry.verdict], 17, placeholder="…")
    axes.text(
        x + _CELL[0] / 2, y + _CELL[1] / 2, said, ha="center", va="center_baseline",
        fontsize=6.2, color=_INK[entry.verdict],
        weight="bold" if entry.verdict == "fail" else "normal",
    )  # fmt: skip


def _key(verdict: str, said: str) -> Patch:
    hatch = "//////" if verdict == "skip" else None
    edge = "#c4c4c4" if verdict == "skip" else "none"
    return Patch(fc=_FACE[verdict], ec=edge, lw=0.4, hatch=hatch, label=said)
