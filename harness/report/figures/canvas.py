"""Where figures are saved."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL.Image import Image
from pypdfium2 import PdfDocument

T = TypeVar("T")

DPI = 160
_POINTS = 72
"""Of a PDF, per inch."""
_PNG_LEVEL = 4
"""Of zlib: the default, 6, takes up to three times as long for 1 to 3 % of size."""
_CSS_PIXELS = 110
"""Per inch on the page: a little larger than life, so that small print can be read."""


@dataclass(frozen=True)
class Drawn:
    """One figure on disk: the PNG, all its files, what it shows, its size in CSS pixels."""

    png: Path
    files: list[Path]
    title: str
    caption: str
    width: int
    height: int


@dataclass
class Canvas:
    """Saves figures into ``folder``.

    Of several figures of one kind that canvases share, ``share`` (which, of how many) says whose
    turn it is.
    """

    folder: Path
    drawn: list[Drawn] = field(default_factory=list)
    share: tuple[int, int] = (0, 1)

    def mine(self, figures: Iterable[T]) -> list[T]:
        """Those of ``figures`` that this canvas is to draw."""
        which, of = self.share
        return list(figures)[which::of]

    def save(self, figure: Figure, name: str, title: str, caption: str) -> Drawn:
        """Write ``name``.pdf, and .png of what the PDF shows. No dates inside."""
        self.folder.mkdir(parents=True, exist_ok=True)
        stem = re.sub(r"[^A-Za-z0-9._-]+", "-", name)
        png, pdf = (self.folder / f"{stem}.{end}" for end in ("png", "pdf"))
        figure.savefig(pdf, metadata={"CreationDate": None, "Producer": None, "Creator": None})
        _rasterised(pdf).save(png, compress_level=_PNG_LEVEL)
        width, height = (round(_CSS_PIXELS * inches) for inches in figure.get_size_inches())
        self.drawn.append(Drawn(png, [png, pdf], title, caption, width, height))
        return self.drawn[-1]


def _rasterised(pdf: Path) -> Image:
    """The page of a PDF as pixels: a tenth of the time that drawing the figure again takes."""
    with PdfDocument(pdf) as document:
        return document[0].render(scale=DPI / _POINTS).to_pil()


def sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """An empty figure whose one pair of axes has inches as its units, the origin below left.

    Many pictures on one pair of axes draw much faster than each on its own.
    """
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.set_autoscale_on(False)
    return figure, axes


def picture(axes: Axes, pixels: Any, box: tuple[float, float, float, float], **options: Any) -> Any:
    """Show ``pixels`` in ``box`` (left, bottom, width, height) of a :func:`sheet`."""
    left, bottom, width, height = box
    extent = (left, left + width, bottom, bottom + height)
    options = {"aspect": "auto", "interpolation": "nearest"} | options
    return axes.imshow(pixels, extent=extent, **options)


def wrapped(label: str, width: int = 13) -> str:
    """A method's label on several lines, broken after hyphens."""
    return "\n".join(textwrap.wrap(label, width, break_long_words=False))
