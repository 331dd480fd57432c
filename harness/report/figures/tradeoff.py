"""Accuracy against time: what variance a sample leaves, and what it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn, log_ticks, styled
from harness.report.figures.palette import Look, looks
from harness.report.figures.small_multiples import Labels, panels

ORDER = 20
_ALL = "geometric mean"
_SIZE = (2.25, 1.75)
"""Inches of a panel."""


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
        drawn = [_scene(results, canvas, scene) for scene in canvas.mine(scenes)]
    found = [figure for figure in drawn if figure is not None]
    return found or "no method has both a divergence and a time"


def _scene(results: Results, canvas: Canvas, scene: str) -> Drawn | None:
    of = {material: _points(results, material, scene) for material in results.materials}
    of = {material: points for material, points in of.items() if points}
    if not of:
        return None
    if len(of) > 1:
        of = {_ALL: _means(results, list(of.values()))} | of
    weights = bool(results.trials("sample-weights"))
    quantity = "relative variance" if weights else "χ² divergence"
    look = looks(results)
    shown = {p.method.label for points in of.values() for p in points}
    handles = [_handle(look[m.label], m.label) for m in results.methods if m.label in shown]
    handles.append(Line2D([], [], color="#999999", lw=1.0, label="front"))
    stacks = [[Labels("ns per rendered sample", quantity, t, emphasised=t == _ALL)] for t in of]
    figure, grid = panels(stacks, _SIZE, handles)
    for (panel,), points in zip(grid, of.values(), strict=True):
        _panel(panel, points, look)
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
        + (f" The {_ALL} is of methods with a number on every material." * (len(of) > 1)),
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
    finite = [p for p in points if 0 < p.error.value < math.inf]
    for point in finite:
        style = look[point.method.label]
        panel.plot(
            point.time.value, point.error.value, color=style.colour, marker=style.marker,
            ms=9 if style.marker == "*" else 6, mec="white", mew=0.4, zorder=3,
        )  # fmt: skip
    bars = [bar for point in finite for bar in _bars(point)]
    colours = [look[p.method.label].colour for p in finite for _ in _bars(p)]
    panel.add_collection(LineCollection(bars, colors=colours, linewidths=0.9, zorder=2.5))
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


def _bars(point: Point) -> list[list[tuple[float, float]]]:
    """The intervals of a point as lines, of those that it has."""
    time, error = point.time, point.error
    across = [(time.low, error.value), (time.high, error.value)]
    along = [(time.value, error.low), (time.value, error.high)]
    return [across] * time.has_interval + [along] * error.has_interval


def _handle(style: Look, label: str) -> Line2D:
    return Line2D([], [], color=style.colour, marker=style.marker, ls="", ms=6, label=label)
