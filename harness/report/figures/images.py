"""Renders of equal time beside the reference (the paper's Figures 1, 9 and 10).

A row is a material: the whole picture once, from the reference, and the square in which the
methods are furthest from it enlarged, as each renders it.
"""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from harness.analysis.results import NO_TRIAL, Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, wrapped
from harness.report.figures.rendered import exposure, srgb
from harness.report.figures.slices import missing
from harness.report.figures.style import PAGE, TICK, TITLE, styled
from harness.report.formats.short import short
from harness.report.series.shots import (
    MEASURES,
    Shot,
    Square,
    scenes,
    shots,
    truth,
    worst_square,
)

ORDER = 70
_ROWS = 5
"""Most materials of one figure."""
_ACROSS = 7
"""Most enlarged squares in a line."""
_WHOLE, _GAP = 1.62, 0.05
"""Inches: width of the whole picture, and between pictures."""
_HEAD, _UNDER, _NAME = 0.3, 0.26, 0.2
"""Inches: a square's label above, its numbers below, and the name of the material."""
_FRAME = {"fill": False, "ec": "#ffcc00", "lw": 0.9}


@dataclass(frozen=True)
class _Row:
    """A material: its shots, the picture to look at, and the square to enlarge."""

    material: str
    shots: list[Shot]
    reference: NDArray | None
    whole: NDArray
    square: Square

    @property
    def scale(self) -> float:
        return exposure(self.whole)


def images(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene, or several of a few materials each."""
    drawn = []
    with styled():
        for scene in canvas.mine(scenes(results)):
            rows = [row for m in results.materials if (row := _row(results, m, scene))]
            pages = [rows[i : i + _ROWS] for i in range(0, len(rows), _ROWS)]
            for number, page in enumerate(pages, 1):
                part = f"-{number}" if len(pages) > 1 else ""
                drawn.append(_figure(canvas, scene, page, part))
    return drawn or f"no trial of the measures {' and '.join(MEASURES)} stored an image"


def _row(results: Results, material: str, scene: str) -> _Row | None:
    made = [shot for shot in shots(results, material, scene) if shot.why != NO_TRIAL]
    if not made:
        return None
    renders = [shot.image for shot in made if shot.image is not None]
    true = truth(results, material, scene, made)
    whole = renders[0] if true is None else true
    mask = next((shot.mask for shot in made if shot.mask is not None), None)
    return _Row(material, made, true, whole, worst_square(renders, whole, mask))


def _figure(canvas: Canvas, scene: str, rows: list[_Row], part: str) -> Drawn:
    count = max(len(row.shots) + (row.reference is not None) for row in rows)
    lines = -(-count // _ACROSS)
    across = -(-count // lines)
    side = (PAGE - _WHOLE - 0.1) / max(across, 5) - _GAP
    line = _HEAD + side + _UNDER
    talls = [max(lines * line, _height(row) + 0.1) + _NAME for row in rows]
    figure, axes = sheet(PAGE, sum(talls))
    top = sum(talls)
    for row, tall in zip(rows, talls, strict=True):
        _whole(axes, row, top)
        panels: list[Shot | None] = [None] * (row.reference is not None) + row.shots
        for i, shot in enumerate(panels):
            y, x = divmod(i, across)
            at = (_WHOLE + 0.1 + x * (side + _GAP), top - _NAME - y * line - _HEAD)
            _enlarged(axes, row, shot, at, side)
        top -= tall
    return canvas.save(
        figure,
        f"images-{scene}{part}",
        f"Equal time: {scene}" + f", part {part[1:]}" * bool(part),
        f"The scene {scene}, rendered by each method in equal time. Left: the whole picture"
        + (
            " from the reference: a long render, or the mean of all unbiased methods' long ones."
            if any(row.reference is not None for row in rows)
            else f", by {rows[0].shots[0].method.label}."
        )
        + " Right: the framed square, in which the methods are furthest from it, enlarged. Below "
        "each: samples per pixel, and relMSE, the variance over the squared mean for so many "
        "samples; of a biased method that is not all of its error.",
        vector=False,
    )


def _height(row: _Row) -> float:
    return _WHOLE * row.whole.shape[0] / row.whole.shape[1]


def _whole(axes: Axes, row: _Row, top: float) -> None:
    axes.text(0.02, top - _NAME / 2, row.material, ha="left", va="center", fontsize=TITLE)
    tall = _height(row)
    box = (0.02, top - _NAME - tall, _WHOLE - 0.04, tall - 0.02)
    picture(axes, srgb(row.whole, row.scale), box)
    unit = box[2] / row.whole.shape[1], box[3] / row.whole.shape[0]
    at = row.square
    corner = (box[0] + at.column * unit[0], box[1] + box[3] - (at.row + at.side) * unit[1])
    axes.add_patch(Rectangle(corner, at.side * unit[0], at.side * unit[1], **_FRAME))


def _enlarged(
    axes: Axes, row: _Row, shot: Shot | None, at: tuple[float, float], side: float
) -> None:
    """The square as a shot has it, or as the reference does, below ``at``, with its numbers."""
    x, top = at
    middle = x + side / 2
    label = "reference" if shot is None else shot.method.label
    axes.text(
        middle, top + 0.03, wrapped(label, round(16 * side)), ha="center", va="bottom",
        fontsize=TICK, linespacing=1.0,
    )  # fmt: skip
    box = (x, top - side, side, side)
    image = row.reference if shot is None else shot.image
    if image is None:
        axes.add_patch(Rectangle(box[:2], *box[2:], fill=False, ec="#bbbbbb", lw=0.6))
        missing(axes, (middle, top - side / 2), shot.why)
        return
    rows, columns = (slice(i, i + row.square.side) for i in (row.square.row, row.square.column))
    picture(axes, srgb(image[rows, columns], row.scale), box)
    if shot is None:
        axes.add_patch(Rectangle(box[:2], *box[2:], **_FRAME))
        return
    axes.text(
        middle, top - side - 0.03, _said(shot), ha="center", va="top", fontsize=TICK,
        linespacing=1.15,
    )  # fmt: skip


def _said(shot: Shot) -> str:
    spp = "† spp" if isinstance(shot.spp, str) else f"{shot.spp.value:.0f} spp"
    error = shot.relative_mse
    return f"{spp}\nrelMSE {'†' if isinstance(error, str) else short(error.value)}"
