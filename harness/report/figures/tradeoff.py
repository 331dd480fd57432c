"""Accuracy against time: what variance a sample leaves, and what it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.quantities import nanoseconds_per_sample
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.ink import Ink
from harness.report.figures.labels import Label, place
from harness.report.figures.log_panel import LogPanel, Range, around
from harness.report.figures.palette import Look, looks
from harness.report.figures.style import LABEL, PAGE, THIN, TICK, styled

ORDER = 20
_ALL = "geometric mean"
_ACROSS = 4
"""Small panels in a row."""
_LARGE, _SMALL = 2.6, 0.95
"""Inches that panels are high."""
_LEFT, _GAP, _TITLE, _FOOT, _UNDER = 0.6, 0.36, 0.25, 0.45, 0.2
"""Inches: left of a row, between panels, above each, below the large one and below the last."""
_FRONT = "#999999"


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
    left_out: list[str] = []
    if len(of) > 1:
        means, over, left_out = _means(results, of)
        if means:
            of = {f"{_ALL} over {len(over)} materials": means} | of
    weights = bool(results.trials("sample-weights"))
    quantity = "relative variance" if weights else "χ² divergence"
    ink, lost = _sheet(of, quantity, looks(results))
    several = len(results.scenes("equal-time")) > 1
    return canvas.save(
        ink.done(),
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
        + f" The {_ALL} is over the materials on which each of its methods has a number."
        * (len(of) > 1)
        + f" Not in it: {', '.join(left_out)}." * bool(left_out)
        + f" Without room for their labels: {', '.join(lost)}." * bool(lost),
    )


def _sheet(
    of: dict[str, list[Point]], quantity: str, look: dict[str, Look]
) -> tuple[Ink, list[str]]:
    """A large panel of the first of ``of``, its methods named, above small ones of the others;
    and the methods that had no room for their names."""
    first, *others = of
    rows = -(-len(others) // _ACROSS)
    height = _TITLE + _LARGE + _FOOT + rows * (_TITLE + _SMALL) + _UNDER * bool(rows)
    ink = Ink(PAGE, height)
    times = [t for points in of.values() for p in points for t in _ends(p.time)]
    x = around(np.array(times), 1.25)
    large = LogPanel(
        (_LEFT, height - _TITLE - _LARGE, PAGE - _LEFT - 0.1, _LARGE), x, _range(of[first])
    )
    large.title(ink, first)
    large.frame(ink, most=6)
    left, bottom, wide, tall = large.box
    ink.text(left + wide / 2, bottom - 0.3, "ns per rendered sample", ha="center")
    ink.text(0.12, bottom + tall / 2, quantity, rotation=90, ha="center")
    _panel(ink, large, of[first], look, 7.0)
    width = (PAGE - _LEFT - 0.1 - (_ACROSS - 1) * _GAP) / _ACROSS
    for i, material in enumerate(others):
        row, column = divmod(i, _ACROSS)
        at = (
            _LEFT + column * (width + _GAP),
            height - _TITLE - _LARGE - _FOOT - (row + 1) * (_TITLE + _SMALL),
        )
        small = LogPanel((*at, width, _SMALL), x, _range(of[material]))
        small.title(ink, material)
        small.frame(ink, x_numbers=i + _ACROSS >= len(others), most=3)
        _panel(ink, small, of[material], look, 4.2)
    return ink, _named(ink, large, of[first], look)


def _named(ink: Ink, panel: LogPanel, points: list[Point], look: dict[str, Look]) -> list[str]:
    """Write the methods' names beside their points; those for which there was no room."""
    at = {p.method.label: panel.at(p.time.value, p.error.value) for p in points if _finite(p)}
    labels = [Label(*place, label, look[label].ink) for label, place in at.items()]
    lost = place(
        ink.axes, labels, list(at.values()),
        [tuple(panel.at(p.time.value, p.error.value)) for p in _front(points) if _finite(p)],
        within=panel.box, size=LABEL,
    )  # fmt: skip
    return [label.text for label in lost]


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


def _means(
    results: Results, of: dict[str, list[Point]]
) -> tuple[list[Point], list[str], list[str]]:
    """Geometric means, the materials they are over, and the methods that are left out.

    Over the materials on which all these methods have a positive, finite point, since means over
    different materials do not compare. A method that has none on most materials is left out.
    """
    points = {
        material: {p.method.label: p for p in found if _finite(p)} for material, found in of.items()
    }
    labels = [method.label for method in results.methods]
    counts = {label: sum(label in found for found in points.values()) for label in labels}
    methods = [m for m in results.methods if 2 * counts[m.label] > len(points)]
    over = [m for m, found in points.items() if all(one.label in found for one in methods)]
    if not over or not methods:
        return [], [], []
    means = []
    for method in methods:
        there = [points[material][method.label] for material in over]
        time, error = (
            geometric_mean([getattr(p, name) for p in there], len(there))
            for name in ("time", "error")
        )
        means.append(Point(method, time, error))
    some = [label for label in labels if counts[label] and label not in {m.label for m in methods}]
    return means, over, some


def _panel(
    ink: Ink, panel: LogPanel, points: list[Point], look: dict[str, Look], size: float
) -> None:
    finite = [p for p in points if _finite(p)]
    line = _front(finite)
    ink.line(
        panel.at([p.time.value for p in line], [p.error.value for p in line]), _FRONT, depth=1.5
    )
    for p in finite:
        style = look[p.method.label]
        for bar in _bars(p):
            ink.line(panel.inside(*zip(*bar, strict=True)), style.colour, THIN, depth=2.5)
        here = panel.at([p.time.value], [p.error.value])
        ink.mark(here, style.marker, style.colour, size * (1.4 if style.marker == "*" else 1))
    off = [p.method.label for p in points if p not in finite]
    if off:
        left, bottom, width, height = panel.box
        said = f"infinite or zero: {', '.join(off)}"
        ink.text(left + width, bottom + height - 0.06, said, ha="right", fontsize=TICK)


def _finite(point: Point) -> bool:
    return 0 < point.error.value < math.inf and 0 < point.time.value < math.inf


def _range(points: list[Point]) -> Range:
    """Errors of a panel, with what is within a factor of three of their intervals."""
    values = np.array([p.error.value for p in points if _finite(p)] or [1.0])
    low, high = around(values, 1.0)
    ends = np.array([e for p in points if _finite(p) for e in _ends(p.error)] or [1.0])
    least, most = around(ends, 1.0)
    return max(least, low / 3) / 1.5, min(most, high * 3) * 1.5


def _ends(one: Estimate) -> tuple[float, ...]:
    return (one.value, one.low, one.high) if one.has_interval else (one.value,)


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
