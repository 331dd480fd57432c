"""One picture large, with two squares of it as a few methods render them (NeuSample's Figures 1
and 11)."""

from __future__ import annotations

from harness.analysis.combine import Estimate
from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, sheet
from harness.report.figures.picture_row import (
    GAP,
    PictureRow,
    column_height,
    draw_column,
    draw_name,
    draw_whole,
    row_of,
    said_of,
)
from harness.report.figures.style import PAGE

LEAST = 96
"""Pixels a side of a picture that is shown large."""
MOST = 5
"""Methods of a figure."""
_SQUARES = 2
_WHOLE, _NAME = 2.5, 0.2
"""Inches: width of the whole picture, and height of the material's name."""
_WIDE = 1.2
"""Width over height from which a picture takes the page's width, and the squares stand below."""


def draw_close_up(results: Results, canvas: Canvas, scene: str, material: str) -> Drawn | None:
    """The figure of one material, or None where its picture is too small to be shown large."""
    everyone = row_of(results, material, scene, _SQUARES)
    if everyone is None or min(everyone.whole.shape[:2]) < LEAST:
        return None
    labels = _chosen(results, everyone)
    row = row_of(results, material, scene, _SQUARES, labels)
    if row is None:
        return None
    wide = row.ratio < 1 / _WIDE
    beside = PAGE - 0.04 if wide else PAGE - _WHOLE - 0.12
    side = beside / max(len(row.panels), 5) - GAP
    whole = min(PAGE - 0.04, 4.6) if wide else _WHOLE
    block = column_height(side, len(row.squares))
    height = _NAME + (whole * row.ratio + block if wide else max(whole * row.ratio, block)) + 0.05
    figure, axes = sheet(PAGE, height)
    draw_name(axes, row, (0.02, height - _NAME / 2))
    top = height - _NAME
    draw_whole(axes, row, (0.02, top), whole)
    left, below = (0.02, top - whole * row.ratio) if wide else (whole + 0.12, top)
    for i, shot in enumerate(row.panels):
        draw_column(axes, row, shot, (left + i * (side + GAP), below), side)
    left_out = len(everyone.shots) - len(row.shots)
    return canvas.save(
        figure,
        f"close-up-{material}-{scene}",
        f"Equal time: {material} in {scene}",
        f"{material} in the scene {scene}, rendered by each method in equal time. {said_of([row])}"
        + (
            f" Shown are the baseline, cosine, and the methods of least relMSE; {left_out} more "
            "are in the figures of all methods."
            if left_out
            else ""
        ),
    )


def _chosen(results: Results, row: PictureRow) -> list[str]:
    """At most :data:`MOST` labels in the suite's order: baseline, cosine, the least relMSE."""
    if len(row.shots) <= MOST:
        return [shot.method.label for shot in row.shots]
    known = [shot for shot in row.shots if shot.image is not None]
    ranked = sorted(
        (shot for shot in known if isinstance(shot.relative_mse, Estimate)),
        key=lambda shot: shot.relative_mse.value,
    )
    first = [s for s in known if s.method.label == results.baseline or s.method.name == "cosine"]
    labels = dict.fromkeys(shot.method.label for shot in (*first, *ranked, *known))
    taken = list(labels)[:MOST]
    return [shot.method.label for shot in row.shots if shot.method.label in taken]
