"""Lines, areas, markers and words of many panels on one sheet.

Panels with axes of their own spend most of their time on axes: objects for each tick, each with
its transforms. Here a figure is one pair of axes in inches, and all lines that look alike are one
line with gaps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from harness.report.figures.canvas import sheet
from harness.report.figures.style import INK, LABEL, LINE

Box = tuple[float, float, float, float]
"""Left, bottom, width and height in inches."""
_GAP = np.full((1, 2), np.nan)


class Ink:
    """What is to be drawn on a sheet of ``width`` by ``height`` inches; all places in inches."""

    def __init__(self, width: float, height: float) -> None:
        self.figure, self.axes = sheet(width, height)
        self.width, self.height = width, height
        self._lines: dict[tuple, list[NDArray]] = {}
        self._areas: dict[str, list[Path]] = {}
        self._marks: dict[tuple, list[NDArray]] = {}

    def line(
        self, points: NDArray, colour: str, width: float = LINE, dash: Any = "-", depth: float = 3
    ) -> None:
        """A line through ``points`` [P, 2]; greater ``depth`` is in front. A gap is nan."""
        self._lines.setdefault((colour, width, dash, depth), []).extend([points, _GAP])

    def area(self, outline: NDArray, colour: str, within: Box) -> None:
        """A tint inside ``outline`` [P, 2], cut off at the edges of ``within``."""
        frame = Bbox.from_bounds(*within)
        shown = Path(outline, closed=True).clip_to_bbox(frame)
        if len(shown.vertices):
            self._areas.setdefault(colour, []).append(shown)

    def mark(
        self, points: NDArray, marker: str, colour: str, size: float, open: bool = False
    ) -> None:
        """A marker ``size`` points wide at each of ``points`` [P, 2]; an open one is white."""
        self._marks.setdefault((marker, colour, size, open), []).append(points)

    def text(self, x: float, y: float, words: str, **how: Any) -> None:
        """Words at a place; ``how`` are those of matplotlib's text."""
        self.axes.text(x, y, words, **{"fontsize": LABEL, "color": INK, "va": "center"} | how)

    def done(self) -> Figure:
        """The figure with all that was gathered."""
        for colour, areas in self._areas.items():
            path = Path.make_compound_path(*areas)
            self.axes.add_artist(PathPatch(path, fc=colour, alpha=0.15, lw=0, zorder=1))
        for (colour, width, dash, depth), lines in self._lines.items():
            self._add(lines, color=colour, lw=width, ls=dash, zorder=depth)
        for (marker, colour, size, open), marks in self._marks.items():
            face, edge, width = ("white", colour, 0.8) if open else (colour, "white", 0.3)
            look = {"marker": marker, "ms": size, "mfc": face, "mec": edge, "mew": width}
            self._add(marks, ls="", zorder=4, **look)
        return self.figure

    def _add(self, points: list[NDArray], **look: Any) -> None:
        x, y = np.concatenate(points).T
        self.axes.add_artist(Line2D(x, y, **look))
