"""Renders of equal time, side by side (the paper's Figures 9 and 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from harness.analysis.combine import Estimate
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, styled, wrapped
from harness.report.figures.rendered import LUMINANCE, exposure, reference, srgb
from harness.report.figures.slices import missing
from harness.report.formats.short import short

ORDER = 70
MEASURE = "equal-time"
_IMAGE = "equal_time"
_ACROSS = 6
_CELL, _LABEL, _UNDER = 1.9, 0.24, 0.34
"""Inches: width of a render, heights of a line of its label and of the numbers below."""
_CROP = 0.25
"""Side of the enlarged square over the image's."""


@dataclass(frozen=True)
class Shot:
    """A method's render of equal time, or why there is none, and what is said about it."""

    method: MethodColumn
    image: NDArray | None
    spp: Estimate | str
    relative_mse: Estimate | str
    why: str
    mask: NDArray | None = None
    """Pixels [H, W] that show the material under test."""


@dataclass(frozen=True)
class _Look:
    """What all shots of a figure share: reference, exposure, and the square to enlarge."""

    reference: NDArray | None
    scale: float
    corner: tuple[int, int]
    side: int


def images(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene and material."""
    drawn = []
    with styled():
        for scene in results.scenes(MEASURE):
            for material in results.materials:
                shots = _shots(results, material, scene)
                if shots:
                    drawn.append(_figure(results, canvas, scene, material, shots))
    return drawn or f"no trial of the measure {MEASURE} stored an image"


def _shots(results: Results, material: str, scene: str) -> list[Shot]:
    """A shot per method, some without an image; none at all if no method has one."""
    shots = []
    for method in results.methods:
        at = (material, method.label, scene)
        stored = [results.stored(trial) for trial in results.trials(MEASURE, *at)[:1]]
        image = stored[0].images.get(_IMAGE) if stored else None
        mask = stored[0].arrays.get("mask") if stored else None
        spp = results.number(MEASURE, "spp-achieved", *at)
        error = results.number("equal-spp", "relative-variance", *at)
        # The error of a mean of n samples is that of one over n; no reference is needed.
        if isinstance(error, Estimate) and isinstance(spp, Estimate):
            error = Estimate(error.value / spp.value)
        why = "" if image is not None else results.why_missing(MEASURE, *at)
        shots.append(Shot(method, image, spp, error, why, mask))
    return shots if any(shot.image is not None for shot in shots) else []


def _figure(
    results: Results, canvas: Canvas, scene: str, material: str, shots: list[Shot]
) -> Drawn:
    truth = reference(results, material, scene)
    renders = [shot.image for shot in shots if shot.image is not None]
    if truth is not None and truth.shape != renders[0].shape:
        truth = None  # a suite may render the two measures in two sizes
    first = renders[0] if truth is None else truth
    mask = next((shot.mask for shot in shots if shot.mask is not None), None)
    look = _Look(truth, exposure(first), _worst_square(renders, first, mask), _side(first))
    across = min(len(shots), _ACROSS)
    rows = -(-len(shots) // across)
    tall = _CELL * first.shape[0] / first.shape[1]
    label = _LABEL * max(1 + wrapped(shot.method.label, 20).count("\n") for shot in shots)
    line = label + tall + _CELL / 2 + _UNDER
    figure, axes = sheet(across * _CELL, rows * line)
    for i, shot in enumerate(shots):
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
            if truth is not None
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
    row, column = look.corner
    unit = full[2] / shot.image.shape[1]
    frame = {"fill": False, "ec": "#ffcc00", "lw": 1.0}
    size = look.side * unit
    corner = (full[0] + column * unit, full[1] + full[3] - row * unit - size)
    axes.add_patch(Rectangle(corner, size, size, **frame))
    square = np.s_[row : row + look.side, column : column + look.side]
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


def _side(image: NDArray) -> int:
    return max(8, int(_CROP * min(image.shape[:2])))


def _worst_square(renders: list[NDArray], centre: NDArray, mask: NDArray | None) -> tuple[int, int]:
    """Upper left corner of the square in which the renders are furthest from ``centre``.

    What is not in ``mask`` [H, W] does not count.
    """
    # The root keeps a few fireflies from choosing the square.
    scatter = np.mean([np.sqrt(np.abs((r - centre) @ LUMINANCE)) for r in renders], axis=0)
    if mask is not None:
        scatter = scatter * mask
    side = _side(centre)
    sums = np.pad(scatter.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    boxes = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    row, column = np.unravel_index(int(boxes.argmax()), boxes.shape)
    return int(row), int(column)
