"""Error against samples and against seconds (the paper's Figure 8), log-log."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from harness.analysis.records.convergence import curve_of
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, grid_shape, log_ticks, styled
from harness.report.figures.palette import Look, looks

ORDER = 50
MEASURE = "convergence"
_BELOW = 1e-30
"""Stands for a lower bound of zero or less: far below every panel."""
_AXES = (("spp", "samples per pixel"), ("seconds", "seconds"))


def convergence(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene: two panels per material, one for samples, one for seconds."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    with styled():
        return [_scene(results, canvas, scene) for scene in results.scenes(MEASURE)
                if results.trials(MEASURE, scene=scene)]  # fmt: skip


def _scene(results: Results, canvas: Canvas, scene: str) -> Drawn:
    look = looks(results)
    materials = [m for m in results.materials if results.trials(MEASURE, m, scene=scene)]
    rows, columns = grid_shape(len(materials))
    drawn = [m for m in results.methods if results.trials(MEASURE, method=m.label, scene=scene)]
    legend_columns = min(len(drawn) + 1, max(2, round(1.5 * columns)))
    legend_height = 0.2 * -(-(len(drawn) + 1) // legend_columns) + 0.15
    height = 2 * rows * 2.0 + legend_height + 0.1
    width = max(2.7 * columns, 4.2)
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(rect=(0, legend_height / height, 1, 1 - legend_height / height))
    grid = figure.subplots(2 * rows, columns, squeeze=False)
    for panel in grid.flat:
        panel.set_visible(False)
    for i, material in enumerate(materials):
        row, column = divmod(i, columns)
        for j, (x, label) in enumerate(_AXES):
            panel = grid[2 * row + j, column]
            panel.set_visible(True)
            _panel(panel, results, look, material, scene, x)
            panel.set_xlabel(label)
            if column == 0:
                panel.set_ylabel("MSE")
            if j == 0:
                panel.set_title(material)
    handles = [_handle(look[m.label], m.label) for m in drawn]
    handles.append(Line2D([], [], color="#bbbbbb", lw=1, label="slope −1"))
    figure.legend(handles=handles, loc="lower center", ncols=legend_columns, handlelength=3.2)
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
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.grid(True, which="major")
    drawn: list[tuple[np.ndarray, np.ndarray]] = []
    bands: list[tuple[np.ndarray, np.ndarray, np.ndarray, str]] = []
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
                reach = np.abs([arrays[f"{x}_low"] - at, arrays[f"{x}_high"] - at])
                panel.errorbar(at, mse, xerr=reach, fmt="none", ecolor=style.colour, elinewidth=0.7)
            if {"mse_low", "mse_high"} <= arrays.keys():
                low, high = arrays["mse_low"], arrays["mse_high"]
                # A single repeat has no interval.
                if np.isfinite(high).all():
                    bands.append((at, np.where(low > 0, low, _BELOW), high, style.colour))
    if drawn:
        bottom, top = _limits(drawn, bands)
        for at, low, high, colour in bands:
            panel.fill_between(at, low, high, color=colour, alpha=0.15, lw=0, zorder=1)
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
    for factor in 10.0 ** np.arange(-6, 7):
        line = constant * factor / at
        if line.max() > bottom and line.min() < top:
            panel.plot(at, line, color="#cccccc", lw=0.8, zorder=0.5)
    panel.set_xlim(low, high)
    panel.set_ylim(bottom, top)


def _handle(style: Look, label: str) -> Line2D:
    return Line2D(
        [], [], color=style.colour, ls=style.dash, marker=style.marker, ms=4, lw=1.3, label=label
    )
