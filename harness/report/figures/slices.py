"""Each method's pdf beside the target for a few conditions (the paper's Figure 7)."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.patches import Circle

from harness.analysis.records.slices import divergences
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, wrapped
from harness.report.figures.style import LABEL, PAGE, TALL, TICK, styled
from harness.report.formats.short import short
from harness.report.series.slices import BELOW_ZERO

ORDER = 60
MEASURE = "slices"
_ROWS = 12
"""Rows of one figure, if there is room."""
_PANEL = 1.15
"""Inches: most that a disk takes; many methods share the width of the page."""
_LEFT, _TOP, _UNDER = 0.26, 0.42, 0.22
"""Inches: the materials' names, the methods' names, and the numbers below a disk."""
_SMALL, _TINY = 5.5, 4.6
"""Points: words of a disk of half an inch, over and under it."""


def slices(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """Rows conditions of the materials, columns the target and then the methods."""
    ended = [m for m in results.materials if results.trials(MEASURE, m)]
    if not ended:
        return f"no trial of the measure {MEASURE} ended well"
    # Published results keep the densities of some materials alone.
    materials = [m for m in ended if "target" in results.arrays(results.trials(MEASURE, m)[0])]
    if not materials:
        return f"no trial of the measure {MEASURE} keeps its densities"
    each = max(1, _ROWS // len(materials))
    rows: list[tuple[str, int]] = []
    for material in materials:
        stored = len(results.arrays(results.trials(MEASURE, material)[0])["target"])
        rows += [(material, k) for k in range(min(each, stored))]
    # A column of the suite may not be for this measure.
    methods = [m for m in results.methods if results.rows(MEASURE, method=m.label)]
    panel = min(_PANEL, (PAGE - _LEFT - 0.05) / (len(methods) + 1))
    fit = min(_ROWS, int((TALL - _TOP) / (panel + _UNDER)))
    pages = [rows[i : i + fit] for i in range(0, len(rows), fit)]
    with styled():
        return [
            _page(results, canvas, page, methods, panel, "" if len(pages) == 1 else f"-{i}")
            for i, page in enumerate(pages, 1)
        ]


def _page(
    results: Results,
    canvas: Canvas,
    rows: list[tuple[str, int]],
    methods: list[MethodColumn],
    panel: float,
    part: str,
) -> Drawn:
    columns = len(methods) + 1
    height = _TOP + len(rows) * (panel + _UNDER)
    figure, axes = sheet(_LEFT + columns * panel + 0.05, height)
    size = LABEL if panel > 0.75 else _SMALL
    for r, (material, k) in enumerate(rows):
        target = _target(results, material, k)
        norm = PowerNorm(0.5, 0.0, _peak(target))
        y = height - _TOP - r * (panel + _UNDER) - panel / 2
        for c in range(columns):
            disk = _Disk(axes, (_LEFT + (c + 0.5) * panel, y), panel, norm)
            if c == 0:
                disk.show(target)
                disk.under(f"peak {short(_peak(target))}")
            else:
                _method(disk, results, methods[c - 1], material, k)
            if r == 0:
                label = "target p*" if c == 0 else methods[c - 1].label
                _name(axes, disk.centre[0], height - _TOP + 0.02, label, size, panel)
        several = any(m == material and j != k for m, j in rows)
        title = f"{material}\ncondition {k + 1}" if several else material
        axes.text(0.12, y, title, rotation=90, ha="center", va="center", fontsize=size)
    return canvas.save(
        figure,
        f"slices{part}",
        "Densities" + f", part {part[1:]}" * bool(part),
        "Density over the projected disk of outgoing directions, per disk area: the target p* "
        "and the pdf of each method, for randomly drawn conditions. One colour scale a row, from "
        "0 to the target's peak (its 99.9% quantile), with a square root between so that dim "
        "parts can be seen. Under each: KL divergence from the target in nats, and MSE."
        + (f" ‡ {BELOW_ZERO}." if _any_below(results, methods, rows) else ""),
    )


def _any_below(results: Results, methods: list[MethodColumn], rows: list[tuple[str, int]]) -> bool:
    trials = [(results.trials(MEASURE, m, c.label)[:1], k) for m, k in rows for c in methods]
    return any(divergences(results.arrays(t[0]))[0][k] < 0 for t, k in trials if t)


def _target(results: Results, material: str, k: int) -> np.ndarray:
    return results.arrays(results.trials(MEASURE, material)[0])["target"][k]


def _peak(target: np.ndarray) -> float:
    inside = target[np.isfinite(target)]
    return float(np.quantile(inside, 0.999)) or float(inside.max()) or 1.0


def _name(axes: Axes, x: float, y: float, label: str, size: float, panel: float) -> None:
    """A label above a column, in smaller letters where a word is wider than its disk."""
    text = wrapped(label, round(16 * panel) + 3)
    longest = max(len(line) for line in text.split("\n"))
    fits = 72 * 1.1 * panel / (0.56 * longest)  # a letter is about 0.56 of its size wide
    size = min(size, fits)
    axes.text(x, y, text, ha="center", va="bottom", fontsize=size, linespacing=1.1)


@dataclass(frozen=True)
class _Disk:
    """A place for a density: the middle and width of its square in inches, the scale of colours."""

    axes: Axes
    centre: tuple[float, float]
    panel: float
    norm: PowerNorm

    def show(self, density: np.ndarray | None) -> None:
        radius = self.panel * 0.455
        ring = Circle(self.centre, radius, fill=False, ec="#888888", lw=0.5, zorder=3)
        self.axes.add_patch(ring)
        if density is None:
            return
        # Cells at the rim whose centre is off the disk hold no value; they shall not shine.
        self.axes.add_patch(Circle(self.centre, radius, fc="black", lw=0, zorder=-1))
        colours = mpl.colormaps["inferno"].with_extremes(bad=(1, 1, 1, 0))
        left, bottom = (x - radius for x in self.centre)
        inside = np.ma.masked_invalid(density)
        image = picture(
            self.axes, inside, (left, bottom, 2 * radius, 2 * radius), origin="lower",
            cmap=colours, norm=self.norm,
        )  # fmt: skip
        image.set_clip_path(Circle(self.centre, radius, transform=self.axes.transData))

    def under(self, text: str) -> None:
        x, y = self.centre
        size = TICK if self.panel > 0.75 else _TINY
        self.axes.text(
            x, y - self.panel / 2 + 0.01, text, ha="center", va="top", fontsize=size,
            color="#333333", linespacing=1.15,
        )  # fmt: skip


def _method(disk: _Disk, results: Results, method: MethodColumn, material: str, k: int) -> None:
    trials = results.trials(MEASURE, material, method.label)
    if not trials:
        disk.show(None)
        missing(disk.axes, disk.centre, results.why_missing(MEASURE, material, method.label))
        return
    arrays = results.arrays(trials[0])
    disk.show(arrays["pdf"][k])
    kl, mse = divergences(arrays)
    mark = "‡" if kl[k] < 0 else ""
    disk.under(f"KL {short(kl[k])}{mark}\nMSE {short(mse[k])}")


def missing(axes: Axes, centre: tuple[float, float], why: str) -> None:
    """A dagger and the reason where a picture should be."""
    words = "\n".join(textwrap.wrap(why, 20, max_lines=5, placeholder=" …"))
    axes.text(*centre, f"†\n{words}", ha="center", va="center", fontsize=5.5, color="#555555")
