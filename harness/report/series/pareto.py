"""Accuracy against time of every method and its knobs: points of charts, and their fronts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.families import Family, families
from harness.analysis.front import Standing, standings
from harness.analysis.pareto import Chart
from harness.analysis.results import Results

ALL = "geometric mean"


@dataclass(frozen=True)
class Point:
    """A method's two numbers, and its standing among those of its panel."""

    family: Family
    label: str
    x: Estimate
    y: Estimate
    standing: Standing | None = None


@dataclass(frozen=True)
class Panel:
    """What one panel shows. ``levels`` have no place on the x axis, ``off`` none at all."""

    points: list[Point]
    levels: list[Point]
    off: list[str]


def panels(results: Results, chart: Chart, scene: str) -> dict[str, Panel]:
    """A panel per material that has something to compare, the geometric mean over them first."""
    found: dict[str, Panel] = {}
    kin = families(results)
    for material in results.materials:
        points, levels, off = [], [], []
        for family, member in ((f, m) for f in kin for m in f.members):
            x = chart.x(results, material, member.label, scene)
            y = chart.y(results, material, member.label, scene)
            if not isinstance(x, Estimate) or not isinstance(y, Estimate):
                continue
            point = Point(family, member.label, x, y)
            if not 0 < y.value < math.inf:
                off.append(member.label)
            elif chart.level(results, material, member.label):
                # Its knobs cost nothing on this axis.
                levels += [point] if member is family.base else []
            elif 0 < x.value < math.inf:
                points.append(point)
        # One alone is compared with nothing.
        if points and len(points) + len(levels) > 1:
            found[material] = Panel(_stood(points), levels, off)
    if len(found) > 1:
        means = _means(list(found.values()))
        # There is none where no method is on every material.
        return ({ALL: means} if means.points else {}) | found
    return found


def _stood(points: list[Point]) -> list[Point]:
    ranks = standings([(p.x, p.y) for p in points])
    return [Point(p.family, p.label, p.x, p.y, rank) for p, rank in zip(points, ranks, strict=True)]


def _means(panels: list[Panel]) -> Panel:
    """Geometric means of what has a point in every panel."""
    every = len(panels)

    def mean(kind: Callable[[Panel], list[Point]]) -> list[Point]:
        by_label: dict[str, list[Point]] = {}
        for point in itertools.chain(*map(kind, panels)):
            by_label.setdefault(point.label, []).append(point)
        return [
            Point(
                group[0].family,
                label,
                geometric_mean([p.x for p in group], every) if kind is _placed else group[0].x,
                geometric_mean([p.y for p in group], every),
            )
            for label, group in by_label.items()
            if len(group) == every
        ]

    return Panel(_stood(mean(_placed)), mean(_level), [])


def _placed(panel: Panel) -> list[Point]:
    return panel.points


def _level(panel: Panel) -> list[Point]:
    return panel.levels
