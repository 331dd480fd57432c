"""Renders of equal time beside the reference (NeuSample's Figures 1, 9, 10 and 11).

A row is a material: the whole picture once, from the reference, and the squares that tell the
methods apart enlarged, as each renders them. Pictures that are large enough have a figure of
their own too.
"""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, sheet
from harness.report.figures.close_up import MOST, draw_close_up
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
from harness.report.figures.style import PAGE, TALL, styled
from harness.report.series.shots import MEASURES, scenes

ORDER = 70
_ACROSS = 7
"""Most enlarged squares in a line."""
_WHOLE, _NAME = 1.62, 0.2
"""Inches: width of the whole picture, and height of the material's name."""


def images(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A figure per scene, or several of a few materials each."""
    drawn = []
    with styled():
        for scene in canvas.mine(scenes(results)):
            drawn += _scene(results, canvas, scene)
    return drawn or f"no trial of the measures {' and '.join(MEASURES)} stored an image"


def _scene(results: Results, canvas: Canvas, scene: str) -> list[Drawn]:
    found = {m: row_of(results, m, scene, 1) for m in results.materials}
    rows = [row for row in found.values() if row is not None]
    if not rows:
        return []
    count = max(len(row.panels) for row in rows)
    lines = -(-count // _ACROSS)
    large = []
    # A figure of several rows with two squares in each shows as much.
    if lines > 1 or len(rows) == 1:
        shown = (draw_close_up(results, canvas, scene, row.material) for row in rows)
        large = [one for one in shown if one is not None]
    if large and len(rows) == 1 and len(rows[0].shots) <= MOST:
        return large
    if lines == 1:
        rows = [row_of(results, row.material, scene, 2) for row in rows]
    across = -(-count // lines)
    side = (PAGE - _WHOLE - 0.1) / max(across, 5) - GAP
    pages = _pages(rows, lines, side)
    for number, page in enumerate(pages, 1):
        part = f"-{number}" if len(pages) > 1 else ""
        large.append(_figure(canvas, scene, page, part, (lines, across, side)))
    return large


def _pages(rows: list[PictureRow], lines: int, side: float) -> list[list[PictureRow]]:
    """Rows of each figure: as many as a page has room for."""
    pages: list[list[PictureRow]] = [[]]
    room = TALL
    for row in rows:
        tall = _tall(row, lines, side)
        if tall > room and pages[-1]:
            pages.append([])
            room = TALL
        pages[-1].append(row)
        room -= tall
    return pages


def _tall(row: PictureRow, lines: int, side: float) -> float:
    """Inches that a row takes."""
    return max(lines * column_height(side, len(row.squares)), _WHOLE * row.ratio + 0.1) + _NAME


def _figure(
    canvas: Canvas, scene: str, rows: list[PictureRow], part: str, grid: tuple[int, int, float]
) -> Drawn:
    lines, across, side = grid
    talls = [_tall(row, lines, side) for row in rows]
    figure, axes = sheet(PAGE, sum(talls))
    top = sum(talls)
    for row, tall in zip(rows, talls, strict=True):
        draw_name(axes, row, (0.02, top - _NAME / 2))
        draw_whole(axes, row, (0.02, top - _NAME), _WHOLE - 0.04)
        line = column_height(side, len(row.squares))
        for i, shot in enumerate(row.panels):
            y, x = divmod(i, across)
            corner = (_WHOLE + 0.1 + x * (side + GAP), top - _NAME - y * line)
            draw_column(axes, row, shot, corner, side)
        top -= tall
    return canvas.save(
        figure,
        f"images-{scene}{part}",
        f"Equal time: {scene}" + f", part {part[1:]}" * bool(part),
        f"The scene {scene}, rendered by each method in equal time. {said_of(rows)}",
    )
