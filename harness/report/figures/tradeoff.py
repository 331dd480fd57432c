"""Accuracy against time: what variance a sample leaves, and what it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn, grid_shape, log_ticks, styled
from harness.report.figures.palette import Look, looks

ORDER = 20
_ALL = "geometric mean"


@dataclass(frozen=True)
class Point:
    """One method: nanoseconds per sample, and divergence."""

    method: MethodColumn
    time: Estimate
    error: Estimate


def tradeoff(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene: variance under constant light against time per sample, with the front.

    That is the chi-square divergence of the pdf; where the suite measures weights, theirs, which
    methods have, too, whose pdf is none of their samples.
    """
    if not results.trials("pdf") and not results.trials("sample-weights"):
        return "no trial of the measures pdf and sample-weights ended well"
    if not results.trials("equal-time"):
        return "no trial of the measure equal-time ended well"
    with styled():
        scenes = results.scenes("equal-time")
        drawn = [_scene(results, canvas, scene) for scene in scenes]
    found = [figure for figure in drawn if figure is not None]
    return found or "no method has both a divergence and a time"


def _scene(results: Results, canvas: Canvas, scene: str) -> Drawn | None:
    panels = {material: _points(results, material, scene) for material in results.materials}
    panels = {material: points for material, points in panels.items() if points}
    if not panels:
        return None
    if len(panels) > 1:
        panels = {_ALL: _means(results, list(panels.values()))} | panels
    weights = bool(results.trials("sample-weights"))
    quantity = "relative variance" if weights else "χ² divergence"
    look = looks(results)
    shown = {p.method.label for points in panels.values() for p in points}
    rows, columns = grid_shape(len(panels))
    legend_columns = min(len(shown) + 1, max(2, round(1.5 * columns)))
    legend_height = 0.2 * -(-(len(shown) + 1) // legend_columns) + 0.15
    height = rows * 2.5 + legend_height + 0.2
    figure = Figure(figsize=(max(2.8 * columns, 4.4), height), layout="constrained")
    figure.get_layout_engine().set(rect=(0, legend_height / height, 1, 1 - legend_height / height))
    grid = figure.subplots(rows, columns, squeeze=False)
    for panel in grid.flat:
        panel.set_visible(False)
    for i, (title, points) in enumerate(panels.items()):
        panel = grid.flat[i]
        panel.set_visible(True)
        _panel(panel, points, look)
        panel.set_title(title, style="italic" if title == _ALL else "normal")
        panel.set_xlabel("ns per rendered sample")
        if i % columns == 0:
            panel.set_ylabel(quantity)
    handles = [_handle(look[m.label], m.label) for m in results.methods if m.label in shown]
    handles.append(Line2D([], [], color="#999999", lw=1.0, label="front"))
    figure.legend(handles=handles, loc="lower center", ncols=legend_columns)
    several = len(results.scenes("equal-time")) > 1
    return canvas.save(
        figure,
        f"tradeoff-{scene}" if several else "tradeoff",
        f"What accuracy costs{f': {scene}' if several else ''}",
        (
            "Relative variance of one sample's weight under constant light (median condition; "
            "around a wrong mean where the table of bias says so)"
            if weights
            else "χ² divergence of the pdf from its target (the variance under constant light)"
        )
        + f" against the time of one rendered sample in the scene {scene}; both axes logarithmic, "
        "bars are 95% intervals. Lower and further left is better; the grey line joins the methods "
        "that no other beats in both."
        + (f" The {_ALL} is of methods with a number on every material." * (len(panels) > 1)),
    )


def _points(results: Results, material: str, scene: str) -> list[Point]:
    points = []
    for method in results.methods:
        error = (
            results.number("sample-weights", "relative-variance-median", material, method.label)
            if results.trials("sample-weights")
            else results.number("pdf", "chi2", material, method.label)
        )
        time = nanoseconds_per_sample(results, material, method.label, scene)
        if isinstance(error, Estimate) and isinstance(time, Estimate):
            points.append(Point(method, time, error))
    return points


def _means(results: Results, panels: list[list[Point]]) -> list[Point]:
    """Geometric means of the methods that have a positive, finite point in every panel."""
    means = []
    for method in results.methods:
        points = [p for points in panels for p in points if p.method.label == method.label]
        if len(points) == len(panels) and all(0 < p.error.value < math.inf for p in points):
            count = len(points)
            time = geometric_mean([p.time for p in points], count)
            means.append(Point(method, time, geometric_mean([p.error for p in points], count)))
    return means


def _panel(panel: Axes, points: list[Point], look: dict[str, Look]) -> None:
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.grid(True, which="major")
    finite = [p for p in points if 0 < p.error.value < math.inf]
    for point in finite:
        style = look[point.method.label]
        panel.errorbar(
            point.time.value,
            point.error.value,
            xerr=_bars(point.time),
            yerr=_bars(point.error),
            color=style.colour,
            marker=style.marker,
            ms=9 if style.marker == "*" else 6,
            elinewidth=0.9,
            capsize=0,
            mec="white",
            mew=0.4,
            zorder=3,
        )
    line = _front(finite)
    panel.plot(
        [p.time.value for p in line],
        [p.error.value for p in line],
        color="#999999", lw=1.0, zorder=1,
    )  # fmt: skip
    panel.margins(0.12)
    off = [p.method.label for p in points if p not in finite]
    if off:
        said = f"infinite or zero: {', '.join(off)}"
        panel.text(0.98, 0.98, said, transform=panel.transAxes, ha="right", va="top", fontsize=6)
    log_ticks(panel)


def _front(points: list[Point]) -> list[Point]:
    """Points that no other beats in both, from fast to accurate; the ceiling may be one."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.time.value, p.error.value)):
        if not front or point.error.value < front[-1].error.value:
            front.append(point)
    return front


def _bars(estimate: Estimate) -> list[list[float]] | None:
    if not estimate.has_interval:
        return None
    return [
        [max(estimate.value - estimate.low, 0.0)],  # matplotlib refuses a bar of rounding error
        [max(estimate.high - estimate.value, 0.0)],
    ]


def _handle(style: Look, label: str) -> Line2D:
    return Line2D([], [], color=style.colour, marker=style.marker, ls="", ms=6, label=label)
