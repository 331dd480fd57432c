"""Error against samples and against seconds (the paper's Figure 8), log-log."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D

from harness.analysis.records.convergence import curve_of
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, log_ticks, styled
from harness.report.figures.palette import Look, looks
from harness.report.figures.small_multiples import Labels, outline, panels

ORDER = 50
MEASURE = "convergence"
_BELOW = 1e-30
"""Stands for a lower bound of zero or less: far below every panel."""
_AXES = (("spp", "samples per pixel"), ("seconds", "seconds"))
_SIZE = (2.15, 1.4)
"""Inches of a panel."""


def convergence(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene: two panels per material, one for samples, one for seconds."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    with styled():
        scenes = [s for s in results.scenes(MEASURE) if results.trials(MEASURE, scene=s)]
        return [_scene(results, canvas, scene) for scene in canvas.mine(scenes)]


def _scene(results: Results, canvas: Canvas, scene: str) -> Drawn:
    look = looks(results)
    materials = [m for m in results.materials if results.trials(MEASURE, m, scene=scene)]
    drawn = [m for m in results.methods if results.trials(MEASURE, method=m.label, scene=scene)]
    handles = [_handle(look[m.label], m.label) for m in drawn]
    handles.append(Line2D([], [], color="#bbbbbb", lw=1, label="slope −1"))
    stacks = [
        [Labels(x_label, "MSE", material * (x == _AXES[0][0])) for x, x_label in _AXES]
        for material in materials
    ]
    figure, grid = panels(stacks, _SIZE, handles, handle_length=3.2)
    for material, pair in zip(materials, grid, strict=True):
        for panel, (x, _) in zip(pair, _AXES, strict=True):
            _panel(panel, results, look, material, scene, x)
    several = len(results.scenes(MEASURE)) > 1
    return canvas.save(
        figure,
        f"convergence-{scene}" if several else "convergence",
        f"Convergence{f': {scene}' if several else ''}",
        "Mean squared error of the render against samples per pixel and against seconds, both "
        f"axes logarithmic; scene {scene}. Bands are 95% intervals of the error, bars those of the "
        "seconds (all repeats, where there are fewer than six). An unbiased estimator "
        "follows the grey slope of −1; lower and further left is better. What lies below the "
        "noise of the reference is left out."
        + (" A line for each seed." * (results.frame["seed"].nunique() > 1)),
    )


def _panel(
    panel: Axes, results: Results, look: dict[str, Look], material: str, scene: str, x: str
) -> None:
    drawn: list[tuple[np.ndarray, np.ndarray]] = []
    bands: list[tuple[np.ndarray, np.ndarray, np.ndarray, str]] = []
    across: list[tuple[tuple[float, float], tuple[float, float]]] = []
    colours: list[str] = []
    for method in results.methods:
        for trial in results.trials(MEASURE, material, method.label, scene):
            arrays = curve_of(results.arrays(trial))
            style = look[method.label]
            at, mse = arrays[x], arrays["mse"]
            # An error estimate below the reference's own noise may be negative: no logarithm.
            mse = np.where(mse > 0, mse, np.nan)
            if np.isnan(mse).all():
                continue
            zorder = 2 if method.ceiling else 3
            panel.plot(
                at, mse, color=style.colour, ls=style.dash, marker=style.marker, ms=3, lw=1.1,
                zorder=zorder,
            )  # fmt: skip
            drawn.append((at, mse))
            if {f"{x}_low", f"{x}_high"} <= arrays.keys():
                ends = arrays[f"{x}_low"], arrays[f"{x}_high"]
                across += [((low, y), (high, y)) for low, high, y in zip(*ends, mse, strict=True)]
                colours += [style.colour] * len(mse)
            if {"mse_low", "mse_high"} <= arrays.keys():
                low, high = arrays["mse_low"], arrays["mse_high"]
                # A single repeat has no interval.
                if np.isfinite(high).all():
                    bands.append((at, np.where(low > 0, low, _BELOW), high, style.colour))
    if drawn:
        bottom, top = _limits(drawn, bands)
        # One collection draws faster than each band and bar by itself.
        outlines = [outline(at, low, high) for at, low, high, _ in bands]
        shades = [colour for *_, colour in bands]
        panel.add_collection(
            PolyCollection(outlines, facecolors=shades, alpha=0.15, lw=0, zorder=1), autolim=False
        )
        panel.add_collection(LineCollection(across, colors=colours, linewidths=0.7, zorder=2))
        panel.set_ylim(bottom, top)
        _guide(panel, drawn)
    log_ticks(panel)


def _limits(
    drawn: list[tuple[np.ndarray, np.ndarray]],
    bands: list[tuple[np.ndarray, np.ndarray, np.ndarray, str]],
) -> tuple[float, float]:
    """Limits that hold all curves, and of the bands what is within a factor of two of them."""
    curves = np.concatenate([mse for _, mse in drawn])
    low, high = np.nanmin(curves), np.nanmax(curves)
    if bands:
        low = max(low / 2, min(low, np.nanmin([np.nanmin(band[1]) for band in bands])))
        high = min(high * 2, max(high, np.nanmax([np.nanmax(band[2]) for band in bands])))
    return low / 1.2, high * 1.2


def _guide(panel: Axes, drawn: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Lines of slope -1 behind the curves, over the whole panel."""
    low, high = panel.get_xlim()
    bottom, top = panel.get_ylim()
    at = np.array([low, high])
    constant = np.nanmedian(np.concatenate([x * y for x, y in drawn]))
    lines = [constant * factor / at for factor in 10.0 ** np.arange(-6, 7)]
    seen = [np.stack((at, y), -1) for y in lines if y.max() > bottom and y.min() < top]
    panel.add_collection(
        LineCollection(seen, colors="#cccccc", linewidths=0.8, zorder=0.5), autolim=False
    )
    panel.set_xlim(low, high)
    panel.set_ylim(bottom, top)


def _handle(style: Look, label: str) -> Line2D:
    return Line2D(
        [], [], color=style.colour, ls=style.dash, marker=style.marker, ms=4, lw=1.3, label=label
    )
