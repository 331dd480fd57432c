"""Path-traced geometry beside the material learned from it (PureSample, Figure 5)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet
from harness.report.figures.rendered import LUMINANCE, exposure, srgb
from harness.report.figures.style import LABEL, PAGE, TICK, TITLE, styled
from harness.report.formats.short import short

ORDER = 133
MEASURE = "patches"
_CELL, _GAP, _LEFT, _TOP, _UNDER = 1.3, 0.04, 0.28, 0.4, 0.18
"""Inches; a picture is at most ``_CELL`` wide, and smaller where a page would be too narrow."""
_HEADS = ("geometry", "learned", "error")

Pictures = dict[tuple[str, str], tuple[NDArray, NDArray]]
"""Truth and learned [H, W, 3] by material and scene."""


def patches(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per method: rows materials; of each scene truth, learned and error."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    found = {m.label: _pictures(results, m.label) for m in results.methods}
    labels = [label for label, pictures in found.items() if pictures]
    if not labels:
        return f"no trial of the measure {MEASURE} has its images stored"
    with styled():
        return [_figure(results, canvas, label, found[label]) for label in canvas.mine(labels)]


def _pictures(results: Results, label: str) -> Pictures:
    """Those that are stored: a published copy may have left them out."""
    found: Pictures = {}
    for material in results.materials:
        for scene in results.scenes(MEASURE):
            for trial in results.trials(MEASURE, material, label, scene)[:1]:
                images = results.stored(trial).images
                if {"truth", "learned"} <= set(images):
                    found[material, scene] = images["truth"], images["learned"]
    return found


def _figure(results: Results, canvas: Canvas, label: str, pictures: Pictures) -> Drawn:
    scenes = [s for s in results.scenes(MEASURE) if any(s == scene for _, scene in pictures)]
    materials = [m for m in results.materials if any(m == material for material, _ in pictures)]
    cell = min(_CELL, (PAGE - _LEFT) / (3 * len(scenes)) - 5 / 3 * _GAP)
    wide = 3 * cell + 2 * _GAP
    line = cell + _UNDER
    height = _TOP + line * len(materials)
    figure, axes = sheet(_LEFT + len(scenes) * (wide + 3 * _GAP), height)
    for r, material in enumerate(materials):
        y = height - _TOP - r * line - cell
        axes.text(_LEFT / 2, y + cell / 2, material, rotation=90, ha="center", va="center",
                  fontsize=LABEL)  # fmt: skip
        for s, scene in enumerate(scenes):
            x = _LEFT + s * (wide + 3 * _GAP)
            if r == 0:
                axes.text(x + wide / 2, height - 0.05, scene, ha="center", va="top", fontsize=TITLE)
                for k, head in enumerate(_HEADS):
                    middle = x + k * (cell + _GAP) + cell / 2
                    axes.text(
                        middle, y + cell + 0.03, head, ha="center", va="bottom", fontsize=LABEL
                    )
            if (material, scene) in pictures:
                _three(axes, *pictures[material, scene], (x, y), cell)
                found = results.number(MEASURE, "macro-error", material, label, scene)
                if not isinstance(found, str):
                    text = f"difference at large {short(found.value)}"
                    axes.text(x + wide / 2, y - 0.02, text, ha="center", va="top", fontsize=TICK)
    return canvas.save(
        figure,
        f"patches-{label}",
        f"Geometry and learned material, {label}",
        "Mitsuba's path tracer on the triangles of the microgeometry; the material learned from "
        "walks on a flat sheet of the same outline, equally exposed; and their absolute difference "
        "in luminance (black 0, yellow half of white). Difference at large: of means over 6 x 6 "
        "blocks of the picture, squared, over the truth's mean square, the noise taken off. A "
        "material without a texture shows the mean over its tile, also close up.",
    )


def _three(
    axes: Axes, truth: NDArray, learned: NDArray, at: tuple[float, float], cell: float
) -> None:
    scale = exposure(truth)
    error = np.abs((learned.astype(float) - truth) @ LUMINANCE) * scale

    def box(k: int) -> tuple[float, float, float, float]:
        return (at[0] + k * (cell + _GAP), at[1], cell, cell)

    picture(axes, srgb(truth, scale), box(0))
    picture(axes, srgb(learned, scale), box(1))
    picture(axes, error, box(2), cmap="inferno", vmin=0, vmax=0.5)
