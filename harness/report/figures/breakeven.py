"""Total time to a given error against samples: straight lines, and where they cross."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.analysis.breakeven import TIMES, Costs, costs, timed_scenes
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.curve_grid import MARK, Across, curve, groups, method_grid, outline
from harness.report.figures.ink import Ink
from harness.report.figures.log_panel import LogPanel, Range, around
from harness.report.figures.palette import Look, looks
from harness.report.figures.style import styled

ORDER = 40
_BEYOND = 3
"""By what factor a panel reaches beyond its lines."""
_POINTS = 60
_MARKED = slice(4, None, 10)
"""Points of a line that have a marker."""
_RANGE = (1e5, 1e9)
"""Samples shown in any case; wider where crossings lie outside."""


def breakeven(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene, a panel per material."""
    scenes = timed_scenes(results)
    if not scenes:
        return f"no trial of the measures {' or '.join(TIMES)} is stored"
    found = {s: {m: costs(results, m, s) for m in results.materials} for s in scenes}
    good = {
        scene: {m: c for m, c in panels.items() if isinstance(c, Costs)}
        for scene, panels in found.items()
    }
    with styled():
        drawn = [
            _scene(results, canvas, scene, panels, len(scenes) > 1)
            for scene, panels in good.items()
            if panels
        ]
    return drawn or "no material has a variance and a time of the baseline"


def _scene(
    results: Results, canvas: Canvas, scene: str, of: dict[str, Costs], several: bool
) -> Drawn:
    shown = [m for m in results.methods if any(m.label in c.lines for c in of.values())]
    panels = {material: _Lines.of(found) for material, found in of.items()}
    ends = np.array([lines.samples[[0, -1]] for lines in panels.values()])
    look = looks(results)

    def draw(ink: Ink, panel: LogPanel, material: str, labels: Sequence[str], axis: int) -> None:
        for label in reversed([label for label in labels if label in of[material].lines]):
            _line(ink, panel, panels[material], label, look[label])

    reference = next(iter(of.values())).reference
    ink = method_grid(
        list(of), groups(shown, results.baseline), look,
        [Across(f"samples of {reference}", (float(ends.min()), float(ends.max())))],
        "seconds to the error that they reach", lambda material: panels[material].seen, draw,
    )  # fmt: skip
    return canvas.save(
        ink.done(),
        f"breakeven-{scene}" if several else "breakeven",
        f"Break-even{f': {scene}' if several else ''}",
        "Total time (fit, load, then samples) to the error that so many samples of "
        f"{results.baseline} reach, over all pixels of the scene {scene}; both axes logarithmic, "
        "tints are 95% intervals. A row is a material, a column a few methods, named above it. "
        "White circles mark where a method's line crosses the baseline's.",
    )


@dataclass(frozen=True)
class _Lines:
    """Samples [P], the seconds of each method at them, their intervals [2, P], and crossings."""

    samples: NDArray
    totals: dict[str, NDArray]
    bands: dict[str, NDArray]
    crossings: dict[str, tuple[float, float]]
    seen: Range

    @classmethod
    def of(cls, found: Costs) -> _Lines:
        base = found.lines.get(found.reference)
        crossings = {
            label: (at, float(line.total(at)[0]))
            for label, line in found.lines.items()
            if base is not None
            and label != found.reference
            and 0 < (at := line.against(base).at) < math.inf
        }
        where = [at for at, _ in crossings.values()]
        samples = np.geomspace(min([_RANGE[0], *where]) / 2, max([_RANGE[1], *where]) * 2, _POINTS)
        of_each = {label: line.totals(samples) for label, line in found.lines.items()}
        totals = {label: made[0] for label, made in of_each.items()}
        bands = {label: made[1:] for label, made in of_each.items()}
        # A band of a variance that is hardly known spans decades: it leaves the panel.
        seen = around(np.concatenate([*totals.values()]), _BEYOND) if totals else (0.1, 10.0)
        return cls(samples, totals, bands, crossings, seen)


def _line(ink: Ink, panel: LogPanel, lines: _Lines, label: str, look: Look) -> None:
    points = panel.at(lines.samples, lines.totals[label])
    curve(ink, points, look, marked=False)
    ink.mark(points[_MARKED], look.marker, look.colour, MARK)
    edge = outline(lines.samples, *lines.bands[label])
    ink.area(panel.at(edge[:, 0], edge[:, 1]), look.colour, panel.box)
    if label in lines.crossings:
        at, seconds = lines.crossings[label]
        ink.mark(panel.at([at], [seconds]), "o", look.colour, 4.5, open=True)
