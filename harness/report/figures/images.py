"""Renders of equal time, side by side (the paper's Figures 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, wrapped
from harness.report.figures.rendered import LUMINANCE, exposure, srgb
from harness.report.figures.slices import missing
from harness.report.figures.style import styled
from harness.report.formats.short import short
from harness.report.series.shots import MEASURE, Shot, Square, shots, truth, worst_square

ORDER = 70
_ACROSS = 6
_CELL, _LABEL, _UNDER = 1.9, 0.24, 0.34
"""Inches: width of a render, heights of a line of its label and of the numbers below."""


@dataclass(frozen=True)
class _Look:
    """What all shots of a figure share: reference, exposure, and the square to enlarge."""

    reference: NDArray | None
    scale: float
    square: Square


def images(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene and material."""
    drawn = []
    with styled():
        at = [(s, m) for s in results.scenes(MEASURE) for m in results.materials]
        for scene, material in canvas.mine(at):
            made = shots(results, material, scene)
            if made:
                drawn.append(_figure(results, canvas, scene, material, made))
    return drawn or f"no trial of the measure {MEASURE} stored an image"


def _figure(results: Results, canvas: Canvas, scene: str, material: str, made: list[Shot]) -> Drawn:
    renders = [shot.image for shot in made if shot.image is not None]
    true = truth(results, material, scene, made)
    first = renders[0] if true is None else true
    mask = next((shot.mask for shot in made if shot.mask is not None), None)
    look = _Look(true, exposure(first), worst_square(renders, first, mask))
    across = min(len(made), _ACROSS)
    rows = -(-len(made) // across)
    tall = _CELL * first.shape[0] / first.shape[1]
    label = _LABEL * max(1 + wrapped(shot.method.label, 20).count("\n") for shot in made)
    line = label + tall + _CELL / 2 + _UNDER
    figure, axes = sheet(across * _CELL, rows * line)
    for i, shot in enumerate(made):
        row, column = divmod(i, across)
        _shot(axes, shot, look, column * _CELL, (rows - row) * line - label, tall)
    return canvas.save(
        figure,
        f"images-{scene}-{material}",
        f"{material}, {scene}",
        f"{material} in the scene {scene}, rendered by each method in equal time. Below each "
        "image: the framed square enlarged"
        + (
            ", and its absolute error in luminance (black 0, yellow half of white) against the "
            "mean of all unbiased methods' long renders."
            if true is not None
            else "."
        )
        + " relMSE: variance over squared mean, for the samples that fit the time; of a biased "
        "method that is not all of its error.",
        vector=False,
    )


def _shot(axes: Axes, shot: Shot, look: _Look, x: float, top: float, tall: float) -> None:
    """One method: its render below ``top``, the enlarged square and its error, the numbers."""
    middle, gap, small = x + _CELL / 2, 0.02, _CELL / 2
    axes.text(
        middle, top + 0.03, wrapped(shot.method.label, 20), ha="center", va="bottom", fontsize=8,
        linespacing=1.1,
    )  # fmt: skip

    def box(left: float, bottom: float, width: float, height: float) -> tuple:
        return (left + gap, bottom + gap, width - 2 * gap, height - 2 * gap)

    full = box(x, top - tall, _CELL, tall)
    if shot.image is None:
        axes.add_patch(Rectangle(full[:2], *full[2:], fill=False, ec="#bbbbbb", lw=0.6))
        missing(axes, (middle, top - tall / 2), shot.why)
        return
    picture(axes, srgb(shot.image, look.scale), full)
    row, column, side = look.square.row, look.square.column, look.square.side
    unit = full[2] / shot.image.shape[1]
    frame = {"fill": False, "ec": "#ffcc00", "lw": 1.0}
    size = side * unit
    corner = (full[0] + column * unit, full[1] + full[3] - row * unit - size)
    axes.add_patch(Rectangle(corner, size, size, **frame))
    square = np.s_[row : row + side, column : column + side]
    below = top - tall - small
    crop = box(x, below, small, small)
    picture(axes, srgb(shot.image[square], look.scale), crop)
    axes.add_patch(Rectangle(crop[:2], *crop[2:], **frame))
    if look.reference is not None:
        error = np.abs((shot.image - look.reference)[square] @ LUMINANCE) * look.scale
        where = box(x + small, below, small, small)
        picture(axes, error, where, cmap="inferno", vmin=0, vmax=0.5)
    axes.text(
        middle, below - 0.02, _said(shot), ha="center", va="top", fontsize=6.5, linespacing=1.2
    )


def _said(shot: Shot) -> str:
    spp = "† spp" if isinstance(shot.spp, str) else f"{shot.spp.value:.0f} spp"
    error = shot.relative_mse
    return f"{spp}\nrelMSE {'†' if isinstance(error, str) else short(error.value)}"
