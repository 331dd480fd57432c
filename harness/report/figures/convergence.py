"""Error against samples and against seconds (the paper's Figure 8), log-log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from harness.analysis.records.convergence import curve_of
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn
from harness.report.figures.curve_grid import Across, curve, groups, method_grid, outline
from harness.report.figures.ink import Ink
from harness.report.figures.log_panel import LogPanel, Range, around
from harness.report.figures.palette import Look, looks
from harness.report.figures.style import THIN, styled

ORDER = 50
MEASURE = "convergence"
_AXES = (("spp", "samples per pixel"), ("seconds", "seconds"))
_GUIDE = "#c4c4c4"

Curves = dict[tuple[str, str], list[dict[str, NDArray]]]
"""Of each material and method, a curve per trial."""


def convergence(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene: a row per material, columns of a few methods over samples and seconds."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    with styled():
        scenes = [s for s in results.scenes(MEASURE) if results.trials(MEASURE, scene=s)]
        drawn = [_scene(results, canvas, scene) for scene in canvas.mine(scenes)]
    found = [figure for figure in drawn if figure is not None]
    # A share of the figures may be none.
    return found if found or not drawn else "all errors are below the noise of their references"


def _scene(results: Results, canvas: Canvas, scene: str) -> Drawn | None:
    found: Curves = {}
    for material in results.materials:
        for method in results.methods:
            trials = results.trials(MEASURE, material, method.label, scene)
            curves = [_positive(curve_of(results.arrays(trial))) for trial in trials]
            good = [one for one in curves if np.isfinite(one["mse"]).any()]
            if good:
                found[material, method.label] = good
    if not found:
        return None
    materials = [m for m in results.materials if any(m == at[0] for at in found)]
    methods = [m for m in results.methods if any(m.label == at[1] for at in found)]
    look = looks(results)
    across = [
        Across(title, around(np.concatenate([one[x] for c in found.values() for one in c]), 1.15))
        for x, title in _AXES
    ]
    seen = {m: _seen([c for at, c in found.items() if at[0] == m]) for m in materials}

    def draw(ink: Ink, panel: LogPanel, material: str, labels: Sequence[str], axis: int) -> None:
        x = _AXES[axis][0]
        base = found.get((material, labels[0])) or next(
            found[material, label] for label in [*labels, *(m.label for m in methods)]
            if (material, label) in found
        )  # fmt: skip
        panel.guides(ink, -1.0, float(np.nanmedian(base[0][x] * base[0]["mse"])), _GUIDE)
        for label in reversed(labels):
            for one in found.get((material, label), []):
                _curve(ink, panel, one, x, look[label])

    ink = method_grid(
        materials, groups(methods, results.baseline), look, across,
        "mean squared error of the render", lambda material: seen[material], draw,
    )  # fmt: skip
    several = len(results.scenes(MEASURE)) > 1
    return canvas.save(
        ink.done(),
        f"convergence-{scene}" if several else "convergence",
        f"Convergence{f': {scene}' if several else ''}",
        "Mean squared error of the render against samples per pixel and against seconds, both "
        f"axes logarithmic; scene {scene}. A row is a material, a pair of columns a few methods, "
        f"named above it, {results.baseline or 'none'} in each pair. Tints are 95% intervals of "
        "the error, bars those of the seconds (all repeats, where there are fewer than six). An "
        "unbiased estimator follows the grey slope of −1; lower and further left is better. What "
        "lies below the noise of the reference is left out."
        + (" A line for each seed." * (results.frame["seed"].nunique() > 1)),
    )


def _positive(found: dict[str, NDArray]) -> dict[str, NDArray]:
    """Without the errors that have no logarithm: those below the reference's noise."""
    return found | {"mse": np.where(found["mse"] > 0, found["mse"], np.nan)}


def _seen(of: list[list[dict[str, NDArray]]]) -> Range:
    """Limits that hold all curves, and of their intervals what is within a factor of two."""
    curves = [one for several in of for one in several]
    low, high = around(np.concatenate([one["mse"] for one in curves]), 1.0)
    ends = np.concatenate([one[end] for one in curves for end in ("mse_low", "mse_high")])
    ends = ends[np.isfinite(ends)]
    low = max(low / 2, min(low, ends.min(initial=low)))
    high = min(high * 2, max(high, ends.max(initial=high)))
    return low / 1.2, high * 1.2


def _curve(ink: Ink, panel: LogPanel, one: dict[str, NDArray], x: str, look: Look) -> None:
    at, mse, low, high = one[x], one["mse"], one["mse_low"], one["mse_high"]
    curve(ink, panel.at(at, mse), look)
    # A single repeat has no interval. A bound below zero is below every panel.
    if np.isfinite(high).all():
        below = panel.y[0] / 10
        edge = outline(at, np.maximum(low, below), high)
        ink.area(panel.at(edge[:, 0], edge[:, 1]), look.colour, panel.box)
    if f"{x}_low" in one:
        ends = zip(one[f"{x}_low"], one[f"{x}_high"], mse, strict=True)
        for left, right, y in ends:
            if np.isfinite([left, right, y]).all():
                ink.line(panel.inside([left, right], [y, y]), look.colour, THIN, depth=2.5)
