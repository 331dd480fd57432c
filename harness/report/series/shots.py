"""Renders of equal time, a shot for each method, and where in the image they differ most.

They are of the measure ``pictures``, which renders for the eye, where a suite has it; else of
``equal-time``, which renders for its numbers and so fewer pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.analysis.combine import Estimate
from harness.analysis.results import MethodColumn, Results
from harness.report.figures.rendered import LUMINANCE, reference

PICTURES, TIMED = "pictures", "equal-time"
MEASURES = (PICTURES, TIMED)
_IMAGES = {PICTURES: "picture", TIMED: "equal_time"}
_CROP = 0.25
"""Side of a square to enlarge over the image's."""


@dataclass(frozen=True)
class Shot:
    """A method's render of equal time, or why there is none, and what is said about it.

    ``relative_mse``: of the render, from the variance of one sample and the samples that it has.
    """

    method: MethodColumn
    trial: str
    image: NDArray | None
    spp: Estimate | str
    relative_mse: Estimate | str
    why: str
    mask: NDArray | None = None
    """Pixels [H, W] that show the material under test."""


@dataclass(frozen=True)
class Square:
    """A square of an image: its upper left corner and side in pixels."""

    row: int
    column: int
    side: int


def scenes(results: Results) -> list[str]:
    """Scenes of which there may be shots."""
    return list(dict.fromkeys(s for measure in MEASURES for s in results.scenes(measure)))


def shots(results: Results, material: str, scene: str) -> list[Shot]:
    """A shot per method, some without an image; none at all if no method has one."""
    made = []
    measure = _measure(results, material, scene)
    for method in results.methods:
        at = (material, method.label, scene)
        trial = next(iter(results.trials(measure, *at)), "")
        stored = results.stored(trial) if trial else None
        image = stored.images.get(_IMAGES[measure]) if stored else None
        mask = stored.arrays.get("mask") if stored and image is not None else None
        why = "" if image is not None else _why(results, measure, trial, *at)
        spp = results.number(measure, "spp-achieved", *at)
        error = _error(results, measure, spp, *at)
        made.append(Shot(method, trial, image, spp, error, why, mask))
    return made if any(shot.image is not None for shot in made) else []


def _measure(results: Results, material: str, scene: str) -> str:
    stored = (results.stored(t) for t in results.trials(PICTURES, material, scene=scene))
    return PICTURES if any(_IMAGES[PICTURES] in one.images for one in stored) else TIMED


def _error(results: Results, measure: str, spp: Estimate | str, *at: str) -> Estimate | str:
    """relMSE of a shot of ``spp`` samples."""
    if measure == PICTURES:
        return results.number(PICTURES, "relative-mse", *at)
    error = results.number("equal-spp", "relative-variance", *at)
    # The error of a mean of n samples is that of one over n; no reference is needed.
    if isinstance(error, Estimate) and isinstance(spp, Estimate):
        return Estimate(error.value / spp.value)
    return error


def truth(results: Results, material: str, scene: str, of: Sequence[Shot]) -> NDArray | None:
    """The reference of the shots' size, or None."""
    first = next(shot.image for shot in of if shot.image is not None)
    stored = (results.stored(t) for t in results.trials(PICTURES, material, scene=scene))
    kept = next((one.images["reference"] for one in stored if "reference" in one.images), None)
    found = results.once(reference, material, scene) if kept is None else kept
    # A suite may render the two measures in two sizes.
    return found if found is not None and found.shape == first.shape else None


def worst_square(renders: Sequence[NDArray], centre: NDArray, mask: NDArray | None) -> Square:
    """The square in which the renders are furthest from ``centre``.

    What is not in ``mask`` [H, W] does not count.
    """
    scatter = np.mean([_distance(render, centre) for render in renders], axis=0)
    side = side_of(centre)
    boxes = _box_sums(scatter if mask is None else scatter * mask, side)
    row, column = np.unravel_index(int(boxes.argmax()), boxes.shape)
    return Square(int(row), int(column), side)


def telling_squares(
    renders: Sequence[NDArray], centre: NDArray, mask: NDArray | None, count: int = 3
) -> list[Square]:
    """Squares in which the errors of the renders differ most, apart from each other.

    The difference is that of the largest and the smallest mean error over the square.
    """
    side = side_of(centre)
    weight = 1.0 if mask is None else mask
    sums = np.stack([_box_sums(_distance(render, centre) * weight, side) for render in renders])
    spread = sums.max(0) - sums.min(0)
    found = []
    while len(found) < count and spread.max() > 0:
        row, column = (int(i) for i in np.unravel_index(int(spread.argmax()), spread.shape))
        found.append(Square(row, column, side))
        spread[max(0, row - side) : row + side + 1, max(0, column - side) : column + side + 1] = 0
    return found


def square_error(image: NDArray, centre: NDArray, at: Square) -> float:
    """Mean squared error of luminance in the square over the mean squared luminance there."""
    rows, columns = slice(at.row, at.row + at.side), slice(at.column, at.column + at.side)
    found, right = (x[rows, columns] @ LUMINANCE for x in (image, centre))
    power = float(np.square(right).mean())
    return float(np.square(found - right).mean()) / power if power > 0 else np.nan


def side_of(image: NDArray) -> int:
    """Side in pixels of a square to enlarge."""
    return max(8, int(_CROP * min(image.shape[:2])))


def _why(results: Results, measure: str, trial: str, material: str, method: str, scene: str) -> str:
    if trial:
        return "its image is not stored: published results keep those of a few materials"
    return results.why_missing(measure, material, method, scene)


def _distance(render: NDArray, centre: NDArray) -> NDArray:
    """Root of the absolute difference in luminance: a few fireflies do not choose the square."""
    return np.sqrt(np.abs((render - centre) @ LUMINANCE))


def _box_sums(values: NDArray, side: int) -> NDArray:
    """Sums over all squares, by their upper left corners."""
    sums = np.pad(values.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    return sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
