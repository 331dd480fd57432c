"""What the materials look like: a thumbnail of each in every scene."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet
from harness.report.figures.rendered import exposure, reference, srgb
from harness.report.figures.style import LABEL, PAGE, styled

ORDER = 10
MEASURE = "equal-spp"
_ACROSS, _LABEL = 6, 0.2
_CELL = PAGE / _ACROSS
"""Thumbnails side by side; inches of the name above one and of a thumbnail."""


def materials(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A sheet per scene; of each material the mean of all unbiased methods' long renders."""
    drawn = []
    with styled():
        for scene in results.scenes(MEASURE):
            found = {name: reference(results, name, scene) for name in results.materials}
            shown = {name: image for name, image in found.items() if image is not None}
            if not shown:
                continue
            across = min(len(shown), _ACROSS)
            line = _LABEL + _CELL
            rows = -(-len(shown) // across)
            figure, axes = sheet(across * _CELL, rows * line)
            for i, (name, image) in enumerate(shown.items()):
                row, column = divmod(i, across)
                left, bottom = column * _CELL, (rows - row - 1) * line
                tall = _CELL * image.shape[0] / image.shape[1]
                box = (left + 0.02, bottom + 0.02, _CELL - 0.04, tall - 0.04)
                picture(axes, srgb(image, exposure(image)), box, interpolation="lanczos")
                middle = left + _CELL / 2
                axes.text(
                    middle, bottom + tall + 0.04, name, ha="center", va="bottom", fontsize=LABEL
                )
            drawn.append(
                canvas.save(
                    figure,
                    f"materials-{scene}",
                    f"The materials in {scene}",
                    f"The materials in the scene {scene}, each with its own exposure: the mean of "
                    "the long renders of all methods that show no bias.",
                )
            )
    return drawn or f"no trial of the measure {MEASURE} stored an image"
