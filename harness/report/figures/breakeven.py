"""Total time to a given error against samples: straight lines, and where they cross."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterMathtext

from harness.analysis.breakeven import TIMES, CostLine, Costs, costs, timed_scenes
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, log_ticks, styled
from harness.report.figures.palette import Look, looks
from harness.report.figures.small_multiples import Labels, outline, panels

ORDER = 40
_BEYOND = 3
"""By what factor a panel reaches beyond its lines."""
_POINTS = 60
_SIZE = (2.45, 1.9)
"""Inches of a panel."""
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
    look = looks(results)
    shown = [m for m in results.methods if any(m.label in c.lines for c in of.values())]
    handles = [
        Line2D([], [], color=look[m.label].colour, ls=look[m.label].dash, lw=1.3, label=m.label)
        for m in shown
    ]
    handles.append(
        Line2D([], [], color="#555555", marker="o", mfc="white", ls="", ms=4, label="crossing")
    )
    stacks = [
        [Labels(f"samples of {found.reference}", "seconds to its error", material)]
        for material, found in of.items()
    ]
    figure, grid = panels(stacks, _SIZE, handles, handle_length=3.2)
    for (panel,), found in zip(grid, of.values(), strict=True):
        _panel(panel, found, look)
    return canvas.save(
        figure,
        f"breakeven-{scene}" if several else "breakeven",
        f"Break-even{f': {scene}' if several else ''}",
        "Total time (fit, load, then samples) to the error that so many samples of "
        f"{results.baseline} reach, over all pixels of the scene {scene}; both axes logarithmic, "
        "bands are 95% intervals. Circles mark where a method's line crosses the baseline's.",
    )


def _panel(panel: Axes, found: Costs, look: dict[str, Look]) -> None:
    base = found.lines.get(found.reference)
    crossings = {
        label: line.against(base).at
        for label, line in found.lines.items()
        if base is not None and label != found.reference
    }
    inside = [at for at in crossings.values() if 0 < at < math.inf]
    low, high = min([_RANGE[0], *inside]) / 2, max([_RANGE[1], *inside]) * 2
    samples = np.geomspace(low, high, _POINTS)
    curves = {label: line.fixed[0] + samples * line.slope[0] for label, line in found.lines.items()}
    for label, line in found.lines.items():
        style = look[label]
        zorder = 2 if line.method.ceiling else 3
        panel.plot(
            samples, curves[label],
            color=style.colour, ls=style.dash, lw=1.1, zorder=zorder,
        )  # fmt: skip
    bands = [outline(samples, *_band(line, samples)) for line in found.lines.values()]
    shades = [look[label].colour for label in found.lines]
    panel.add_collection(PolyCollection(bands, facecolors=shades, alpha=0.15, lw=0), autolim=False)
    for label, at in crossings.items():
        if 0 < at < math.inf:
            panel.plot(
                at, found.lines[label].total(at)[0], marker="o", mfc="white", ms=4,
                mec=look[label].colour, zorder=4,
            )  # fmt: skip
    panel.set_xlim(low, high)
    if curves:
        # A band of a variance that is hardly known spans decades: it leaves the panel.
        drawn = np.stack([*curves.values()])
        panel.set_ylim(drawn.min() / _BEYOND, drawn.max() * _BEYOND)
    log_ticks(panel)
    for axis in (panel.xaxis, panel.yaxis):
        # Many decades: powers of ten are shorter than numbers.
        axis.set_major_formatter(LogFormatterMathtext())


def _band(line: CostLine, samples: np.ndarray) -> np.ndarray:
    """2.5 and 97.5 percentiles of the total, [2, P]."""
    totals = line.fixed[1:, None] + samples * line.slope[1:, None]
    return np.percentile(totals, [2.5, 97.5], axis=0)
