"""Accuracy against time for every method and its knobs: three figures, each with its front."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox

from harness.analysis.combine import Estimate
from harness.analysis.families import families
from harness.analysis.pareto import CHARTS, Chart
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.knob_path import inserted
from harness.report.figures.labels import Label, place
from harness.report.figures.palette import Look, looks_of
from harness.report.figures.small_multiples import Labels, log_ticks, panels
from harness.report.figures.style import styled
from harness.report.series.pareto import ALL, Panel, Point
from harness.report.series.pareto import panels as panels_of

ORDER = 30
_OPACITY = {"front": 1.0, "possibly": 0.6, "surely": 0.22}
_SIZE = (3.05, 2.65)
"""Inches of a panel."""
_SURE = 0.95
"""A point that is on the front with less probability than this says with how much."""


def pareto(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per chart and scene; panels are materials, the geometric mean first."""
    drawn: list[Drawn] = []
    with styled():
        for chart, scene in canvas.mine((c, s) for c in CHARTS for s in c.scenes(results)):
            found = panels_of(results, chart, scene)
            if found:
                several = len(chart.scenes(results)) > 1
                drawn.append(_figure(results, canvas, chart, scene, found, several))
    return drawn or f"no trial gave both numbers of a chart ({', '.join(c.name for c in CHARTS)})"


def _figure(
    results: Results,
    canvas: Canvas,
    chart: Chart,
    scene: str,
    of: dict[str, Panel],
    several: bool,
) -> Drawn:
    shown = {p.family.base.label for panel in of.values() for p in panel.points + panel.levels}
    kin = [f.base for f in families(results) if f.base.label in shown]
    look = looks_of(kin)
    handles = [_handle(look[m.label], m.label) for m in kin] + _key()
    stacks = [[Labels(chart.x_title, chart.y_title, t, emphasised=t == ALL)] for t in of]
    figure, stacked = panels(stacks, _SIZE, handles, widest=3, handle_length=1.6)
    grid = [axes for (axes,) in stacked]
    for axes, panel in zip(grid, of.values(), strict=True):
        _draw(axes, panel, look)
    # Labels find their places in pixels.
    figure.draw_without_rendering()
    lost = [label for i, p in enumerate(of.values()) for label in _write(grid[i], p, look)]
    where = f" in the scene {scene}" if scene and chart.in_scene(results) else ""
    caption = chart.caption.format(where=where) + _EXPLAINED
    if chart.note(results):
        caption += f" {chart.note(results)}"
    if len(of) > 1:
        caption += f" The {ALL} is of what has a number on every material."
    if lost:
        caption += f" Without room for their labels: {', '.join(dict.fromkeys(lost))}."
    return canvas.save(
        figure,
        f"pareto-{chart.name}-{scene}" if several else f"pareto-{chart.name}",
        f"{chart.title}{f': {scene}' if several else ''}",
        caption,
    )


_EXPLAINED = (
    " Both axes logarithmic, bars are 95% intervals, cut off where they leave the panel; lower and "
    "further left is better. One colour a method, filled where it is as the suite lists it first; "
    "a thin line joins the values of one knob. The grey line is the front, its points labelled, "
    f"with the probability of being on it where that is below {_SURE:.0%}. Faint: another point "
    "is better on both axes, intervals and all; half faint: another's values are, but intervals "
    "overlap."
)


def _draw(axes: Axes, panel: Panel, look: dict[str, Look]) -> None:
    for point in panel.points:
        style = look[point.family.base.label]
        base = point.label == point.family.base.label
        size = 8 if style.marker == "*" else 5
        axes.errorbar(
            point.x.value,
            point.y.value,
            xerr=_bars(point.x),
            yerr=_bars(point.y),
            color=style.colour,
            alpha=_OPACITY[point.standing.place],
            marker=style.marker,
            ms=size,
            mfc=style.colour if base else "white",
            mec="white" if base else style.colour,
            mew=0.4 if base else 0.9,
            elinewidth=0.8,
            capsize=0,
            zorder=4 if point.standing.place == "front" else 3,
        )
    _knob_paths(axes, panel.points, look)
    axes.plot(*zip(*_line(panel), strict=True), color="#777777", lw=1.2, zorder=2)
    axes.set_xlim(*_limits([p.x for p in panel.points]))
    axes.set_ylim(*_limits([p.y for p in panel.points + panel.levels]))
    for level in panel.levels:
        style = look[level.family.base.label]
        axes.axhline(level.y.value, color=style.colour, ls=style.dash, lw=0.8, zorder=1)
    log_ticks(axes)


def _place(point: Point) -> tuple[float, float]:
    return point.x.value, point.y.value


def _line(panel: Panel) -> list[tuple[float, float]]:
    """The front, from fast to accurate."""
    return sorted(_place(p) for p in panel.points if p.standing.place == "front")


def _knob_paths(axes: Axes, points: list[Point], look: dict[str, Look]) -> None:
    """Thin lines through the values of a knob, the base put in where it fits best."""
    at = {p.label: _place(p) for p in points}
    for family in {p.family.base.label: p.family for p in points}.values():
        colour = look[family.base.label].colour
        for path in family.paths():
            route = [at[label] for label in path if label in at]
            if family.base.label in at:
                route = inserted(route, at[family.base.label])
            axes.plot(*zip(*route, strict=True), color=colour, lw=0.6, alpha=0.4, zorder=1)


def _write(axes: Axes, panel: Panel, look: dict[str, Look]) -> list[str]:
    """Label the front and the levels; gives back what found no room."""
    taken: list[Bbox] = []
    if panel.off:
        said = f"infinite or zero: {', '.join(panel.off)}"
        note = axes.text(
            0.98, 0.98, said, transform=axes.transAxes, ha="right", va="top", fontsize=6
        )
        note.set_in_layout(False)
        taken.append(note.get_window_extent())
    labels = []
    for point in panel.points:
        if point.standing.place == "front":
            text, sure = point.family.short(point.label), point.standing.membership
            text += f", {sure:.0%}" if sure < _SURE else ""
            labels.append(Label(*_place(point), text, look[point.family.base.label].colour))
    left = axes.get_xlim()[0]
    for level in panel.levels:
        colour = look[level.family.base.label].colour
        labels.append(Label(left, level.y.value, level.family.short(level.label), colour))
    points = [_place(p) for p in panel.points]
    return [item.text for item in place(axes, labels, points, _line(panel), taken)]


def _limits(shown: list[Estimate]) -> tuple[float, float]:
    """Limits that hold all values, with room for labels; bars may run out of the panel.

    An interval of many decades would leave no room for anything else.
    """
    values = [e.value for e in shown]
    low, high = math.log(min(values)), math.log(max(values))
    room = max(0.16 * (high - low), math.log(1.5))
    return math.exp(low - room), math.exp(high + room)


def _bars(estimate: Estimate) -> list[list[float]] | None:
    if not estimate.has_interval:
        return None
    # A lower bound of zero or less has no place on a logarithmic axis: its bar runs off below.
    low = estimate.low if estimate.low > 0 else estimate.value * 1e-9
    return [
        [max(estimate.value - low, 0.0)],  # matplotlib refuses a bar of rounding error
        [max(estimate.high - estimate.value, 0.0)],
    ]


def _handle(style: Look, label: str) -> Line2D:
    return Line2D([], [], color=style.colour, marker=style.marker, ls="", ms=5, label=label)


def _key() -> list[Line2D]:
    grey = "#444444"
    return [
        Line2D([], [], color="#777777", lw=1.2, label="front"),
        Line2D([], [], color=grey, marker="o", mfc="white", ls="-", lw=0.6, ms=5, label="a knob"),
        Line2D([], [], color=grey, marker="o", ls="", ms=5, alpha=0.6, label="perhaps dominated"),
        Line2D([], [], color=grey, marker="o", ls="", ms=5, alpha=0.22, label="dominated"),
    ]
