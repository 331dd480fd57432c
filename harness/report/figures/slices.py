"""Each method's pdf beside the target for a few conditions (the paper's Figure 7)."""

from __future__ import annotations

import textwrap

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.patches import Circle

from harness.analysis.records.slices import divergences
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, wrapped
from harness.report.figures.style import styled
from harness.report.formats.short import short
from harness.report.series.slices import BELOW_ZERO

ORDER = 60
MEASURE = "slices"
_ROWS = 12
"""Most rows of one figure."""
_PANEL = 1.15
"""Inches."""


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
    pages = [rows[i : i + _ROWS] for i in range(0, len(rows), _ROWS)]
    with styled():
        return [
            _page(results, canvas, page, "slices" if len(pages) == 1 else f"slices-{i}")
            for i, page in enumerate(pages, 1)
        ]


def _page(results: Results, canvas: Canvas, rows: list[tuple[str, int]], name: str) -> Drawn:
    # A column of the suite may not be for this measure.
    methods = [m for m in results.methods if results.rows(MEASURE, method=m.label)]
    columns = len(methods) + 1
    left, top, under = 0.30, 0.42, 0.30
    height = top + len(rows) * (_PANEL + under)
    figure, axes = sheet(left + columns * _PANEL + 0.05, height)
    for r, (material, k) in enumerate(rows):
        target = _target(results, material, k)
        norm = PowerNorm(0.5, 0.0, _peak(target))
        y = height - top - r * (_PANEL + under) - _PANEL / 2
        for c in range(columns):
            centre = (left + (c + 0.5) * _PANEL, y)
            if c == 0:
                _disk(axes, centre, target, norm)
                _under(axes, centre, f"peak {short(_peak(target))}")
            else:
                _method(axes, centre, results, methods[c - 1], material, k, norm)
            if r == 0:
                label = "target p*" if c == 0 else methods[c - 1].label
                axes.text(
                    centre[0], height - top + 0.02, wrapped(label), ha="center", va="bottom",
                    fontsize=7.5, linespacing=1.15,
                )  # fmt: skip
        several = any(m == material and j != k for m, j in rows)
        title = f"{material}\ncondition {k + 1}" if several else material
        axes.text(0.15, y, title, rotation=90, ha="center", va="center", fontsize=7)
    return canvas.save(
        figure,
        name,
        "Densities",
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


def _method(
    axes: Axes,
    centre: tuple[float, float],
    results: Results,
    method: MethodColumn,
    material: str,
    k: int,
    norm: PowerNorm,
) -> None:
    trials = results.trials(MEASURE, material, method.label)
    if not trials:
        _disk(axes, centre, None, norm)
        missing(axes, centre, results.why_missing(MEASURE, material, method.label))
        return
    arrays = results.arrays(trials[0])
    _disk(axes, centre, arrays["pdf"][k], norm)
    kl, mse = divergences(arrays)
    mark = "‡" if kl[k] < 0 else ""
    _under(axes, centre, f"KL {short(kl[k])}{mark}\nMSE {short(mse[k])}")


def missing(axes: Axes, centre: tuple[float, float], why: str) -> None:
    """A dagger and the reason where a picture should be."""
    words = "\n".join(textwrap.wrap(why, 20, max_lines=5, placeholder=" …"))
    axes.text(*centre, f"†\n{words}", ha="center", va="center", fontsize=5.5, color="#555555")


def _disk(
    axes: Axes, centre: tuple[float, float], density: np.ndarray | None, norm: PowerNorm
) -> None:
    radius = _PANEL / 2 - 0.05
    axes.add_patch(Circle(centre, radius, fill=False, ec="#888888", lw=0.6, zorder=3))
    if density is not None:
        # Cells at the rim whose centre is off the disk hold no value; they shall not shine.
        axes.add_patch(Circle(centre, radius, fc="black", lw=0, zorder=-1))
        colours = mpl.colormaps["inferno"].with_extremes(bad=(1, 1, 1, 0))
        box = (centre[0] - radius, centre[1] - radius, 2 * radius, 2 * radius)
        inside = np.ma.masked_invalid(density)
        image = picture(axes, inside, box, origin="lower", cmap=colours, norm=norm)
        image.set_clip_path(Circle(centre, radius, transform=axes.transData))


def _under(axes: Axes, centre: tuple[float, float], text: str) -> None:
    axes.text(
        centre[0], centre[1] - _PANEL / 2 + 0.01, text, ha="center", va="top", fontsize=6,
        color="#333333", linespacing=1.15,
    )  # fmt: skip
