"""A material's whole picture, and squares of it enlarged as each method renders them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from harness.analysis.results import NO_TRIAL, Results
from harness.report.figures.canvas import picture, wrapped
from harness.report.figures.rendered import exposure, srgb
from harness.report.figures.slices import missing
from harness.report.figures.style import TICK, TITLE
from harness.report.formats.short import short
from harness.report.series.shots import (
    Shot,
    Square,
    shots,
    square_error,
    telling_squares,
    truth,
    worst_square,
)

GAP = 0.05
"""Inches between pictures."""
_HEAD, _NUMBERS, _OWN = 0.3, 0.26, 0.12
"""Inches: a column's label above, its numbers below, and the error in one square under that."""
_FRAMES = (
    {"fill": False, "ec": "#ffcc00", "lw": 0.9},
    {"fill": False, "ec": "#8ad8ff", "lw": 0.9, "ls": (0, (3, 1))},
)
"""Of the first and the second square: yellow, and pale blue with dashes."""

SQUARES = (
    "the squares in which the errors of the methods differ most, or, of one method, where it is "
    "furthest from the reference"
)


@dataclass(frozen=True)
class PictureRow:
    """A material: its shots, the picture to look at, and the squares to enlarge.

    ``whole`` is the reference, or else the first render.
    """

    material: str
    shots: list[Shot]
    reference: NDArray | None
    whole: NDArray
    squares: list[Square]

    @property
    def scale(self) -> float:
        """Factor from radiance to white."""
        return exposure(self.whole)

    @property
    def panels(self) -> list[Shot | None]:
        """What stands side by side; None is the reference."""
        return [None] * (self.reference is not None) + self.shots

    @property
    def ratio(self) -> float:
        """Height over width of the picture."""
        return self.whole.shape[0] / self.whole.shape[1]


def row_of(
    results: Results, material: str, scene: str, squares: int, only: Sequence[str] = ()
) -> PictureRow | None:
    """The row of a material, of the methods labelled ``only`` if any are named; None without
    images."""
    made = [shot for shot in shots(results, material, scene) if shot.why != NO_TRIAL]
    if only:
        by_label = {shot.method.label: shot for shot in made}
        made = [by_label[label] for label in only if label in by_label]
    renders = [shot.image for shot in made if shot.image is not None]
    if not renders:
        return None
    true = truth(results, material, scene, made)
    whole = renders[0] if true is None else true
    mask = next((shot.mask for shot in made if shot.mask is not None), None)
    found = telling_squares(renders, whole, mask, squares) or [worst_square(renders, whole, mask)]
    return PictureRow(material, made, true, whole, found)


def draw_whole(axes: Axes, row: PictureRow, corner: tuple[float, float], width: float) -> None:
    """The whole picture below ``corner`` (left, top), with its squares framed."""
    left, top = corner
    tall = width * row.ratio
    picture(axes, srgb(row.whole, row.scale), (left, top - tall, width, tall))
    unit = width / row.whole.shape[1], tall / row.whole.shape[0]
    for at, frame in zip(row.squares, _FRAMES, strict=False):
        low = (left + at.column * unit[0], top - (at.row + at.side) * unit[1])
        axes.add_patch(Rectangle(low, at.side * unit[0], at.side * unit[1], **frame))


def draw_name(axes: Axes, row: PictureRow, at: tuple[float, float]) -> None:
    """The material's name."""
    axes.text(*at, row.material, ha="left", va="center", fontsize=TITLE)


def column_height(side: float, squares: int) -> float:
    """Inches that :func:`draw_column` takes."""
    own = _OWN if squares > 1 else 0.0
    return _HEAD + squares * (side + own) + (squares - 1) * GAP + _NUMBERS


def draw_column(
    axes: Axes, row: PictureRow, shot: Shot | None, corner: tuple[float, float], side: float
) -> None:
    """A method's squares below each other (or, with None, the reference's) with their numbers,
    below ``corner`` (left, top)."""
    left, top = corner
    middle = left + side / 2
    label = "reference" if shot is None else shot.method.label
    top -= _HEAD
    axes.text(
        middle, top + 0.03, wrapped(label, round(16 * side)), ha="center", va="bottom",
        fontsize=TICK, linespacing=1.0,
    )  # fmt: skip
    several = len(row.squares) > 1
    image = row.reference if shot is None else shot.image
    for at, frame in zip(row.squares, _FRAMES, strict=False):
        box = (left, top - side, side, side)
        if image is None:
            axes.add_patch(Rectangle(box[:2], side, side, fill=False, ec="#bbbbbb", lw=0.6))
            missing(axes, (middle, top - side / 2), shot.why)
        else:
            rows, columns = (slice(i, i + at.side) for i in (at.row, at.column))
            picture(axes, srgb(image[rows, columns], row.scale), box)
        if shot is None:
            axes.add_patch(Rectangle(box[:2], side, side, **frame))
        top -= side
        if several:
            if shot is not None and image is not None and row.reference is not None:
                own = short(square_error(image, row.reference, at))
                axes.text(middle, top - 0.02, own, ha="center", va="top", fontsize=TICK - 0.5)
            top -= _OWN
        top -= GAP
    if shot is not None and image is not None:
        axes.text(
            middle, top + GAP - 0.03, _said(shot), ha="center", va="top", fontsize=TICK,
            linespacing=1.15,
        )  # fmt: skip


def said_of(rows: Sequence[PictureRow]) -> str:
    """What the numbers and frames are, for a caption."""
    several = any(len(row.squares) > 1 for row in rows)
    true = any(row.reference is not None for row in rows)
    first = rows[0].shots[0].method.label
    return (
        "Left: the whole picture"
        + (
            " from the reference, a long render or the mean of all unbiased methods' long ones."
            if true
            else f", by {first}."
        )
        + f" Right, enlarged: {SQUARES}"
        + ("; under each its relMSE in that render." if several and true else ".")
        + " Below: samples per pixel, and relMSE of the whole, the variance over the squared mean "
        "for so many samples; of a biased method that is not all of its error. †: no number."
    )


def _said(shot: Shot) -> str:
    spp = "† spp" if isinstance(shot.spp, str) else f"{shot.spp.value:.0f} spp"
    error = shot.relative_mse
    return f"{spp}\nrelMSE {'†' if isinstance(error, str) else short(error.value)}"
