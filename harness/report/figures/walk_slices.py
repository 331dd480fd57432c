"""Where light goes by walks and by the material learned from them (PureSample, Figures 6 to 8)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet
from harness.report.figures.rendered import srgb
from harness.report.figures.style import styled
from harness.report.formats.short import short

ORDER = 134
MEASURE = "walk-slices"
_CELL, _GAP, _LEFT, _TOP, _UNDER = 1.1, 0.05, 0.28, 0.4, 0.16
"""Inches."""


def walk_slices(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A row per material: its latent texture if it has one; per angle walks beside learned."""
    stored = {m: results.trials(MEASURE, m) for m in results.materials}
    rows = {m: results.arrays(trials[0]) for m, trials in stored.items() if trials}
    if not rows:
        return f"no trial of the measure {MEASURE} ended well"
    textured = any("latent" in raw for raw in rows.values())
    first = _LEFT + textured * (_CELL + 3 * _GAP)
    angles = max(len(raw["wi"]) for raw in rows.values())
    line, pair = _CELL + _UNDER, 2 * _CELL + 4 * _GAP
    height = _TOP + line * len(rows)
    with styled():
        figure, axes = sheet(first + angles * pair, height)
        for r, (material, raw) in enumerate(rows.items()):
            y = height - _TOP - r * line - _CELL
            axes.text(_LEFT / 2, y + _CELL / 2, material, rotation=90, ha="center", va="center",
                      fontsize=7)  # fmt: skip
            if "latent" in raw:
                picture(axes, raw["latent"], (_LEFT, y, _CELL, _CELL))
                _head(axes, _LEFT, y + _CELL, "latent texture")
            for i in range(len(raw["wi"])):
                x = first + i * pair
                if r == 0:
                    degrees = np.degrees(np.arcsin(np.linalg.norm(raw["wi"][i].astype(float))))
                    axes.text(x + pair / 2, height - 0.05, f"incidence at {degrees:.0f}°",
                              ha="center", va="top")  # fmt: skip
                    _head(axes, x, y + _CELL, "walks")
                    _head(axes, x + _CELL + _GAP, y + _CELL, "learned")
                _pair(axes, raw, i, x, y)
                method = results.methods[0].label
                found = results.number(MEASURE, f"kl-{i}", material, method)
                if not isinstance(found, str):
                    text = f"KL {short(found.value)} nats"
                    axes.text(x + pair / 2, y - 0.02, text, ha="center", va="top", fontsize=6.5)
        return [
            canvas.save(
                figure,
                "walk-slices",
                "Where light goes",
                "f over the projected disk of outgoing directions at a few angles of incidence: by "
                "particles walking through the microgeometry, counted in 48 x 48 cells of equal "
                "area, and of the material learned from walks; log(1 + f), a pair equally bright. "
                "KL: of the particles' directions to the learned density, what counts add by "
                "chance taken off. Latent texture: its three directions of most variance, as "
                "colours.",
            )
        ]


def _head(axes: Axes, x: float, y: float, text: str) -> None:
    axes.text(x + _CELL / 2, y + 0.03, text, ha="center", va="bottom", fontsize=7)


def _pair(axes: Axes, raw: dict[str, NDArray], i: int, x: float, y: float) -> None:
    """Means of f over the cells, side by side."""
    cells = raw["count"].shape[-1]
    area = np.pi / cells
    walked = raw["count"][i].astype(float) / float(raw["walks"]) / area
    learned = raw["mass"][i].astype(float) / area
    peak = float(np.quantile(np.log1p(walked), 0.995))
    for k, f in enumerate((walked, learned)):
        image = _on_disk(srgb(np.log1p(f.T), 1 / peak if peak > 0 else 1), raw["raster"])
        picture(axes, image, (x + k * (_CELL + _GAP), y, _CELL, _CELL))


def _on_disk(cells: NDArray, raster: NDArray) -> NDArray:
    """Values [C, 3] of cells as a picture of the disk, one off it."""
    return np.where((raster >= 0)[..., None], cells[raster], 1)
