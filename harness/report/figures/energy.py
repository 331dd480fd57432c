"""Albedo of materials learned from walks beside that of the walks, by angle."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, sheet
from harness.report.figures.style import styled

ORDER = 135
MEASURE = "walks"
_WIDE, _HIGH, _COLUMNS = 2.3, 1.9, 3
_COLOURS = ("#b03030", "#308040", "#3050b0")
_Z = 1.959964
"""Of a 95 % interval."""


def energy(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A panel a material: lines of the network, points with intervals of the walks, by channel."""
    stored = {m: results.trials(MEASURE, m) for m in results.materials}
    materials = [m for m, trials in stored.items() if trials]
    if not materials:
        return f"no trial of the measure {MEASURE} ended well"
    rows = -(-len(materials) // _COLUMNS)
    columns = min(_COLUMNS, len(materials))
    with styled():
        figure, page = sheet(columns * _WIDE, rows * _HIGH + 0.2)
        page.axis("off")
        for i, material in enumerate(materials):
            raw = results.arrays(stored[material][0])
            x = (i % _COLUMNS) / columns
            y = 1 - (i // _COLUMNS + 1) / rows
            panel = figure.add_axes(
                (x + 0.24 / columns, y + 0.24 / rows, 0.72 / columns, 0.62 / rows)
            )
            _panel(panel, raw, material)
            if i == 0:
                panel.legend(handles=_key(), loc="best", frameon=False)
        return [
            canvas.save(
                figure,
                "energy",
                "Energy",
                "Albedo by the cosine of the direction of incidence, in each channel: the material "
                "learned from walks (lines) and the share of particles that leave its "
                "microgeometry (points, with 95 % intervals), in the mean over azimuths.",
            )
        ]


def _key() -> list[Line2D]:
    """What points and lines are, whatever their colour."""
    return [
        Line2D([], [], color="0.3", marker=".", linestyle="", label="walks"),
        Line2D([], [], color="0.3", linewidth=1, label="learned"),
    ]


def _panel(axes, raw: dict[str, np.ndarray], material: str) -> None:
    cosine, n = raw["cosine"], float(raw["walks"])
    known = raw["left"].astype(float) / n
    error = np.sqrt((known * (1 - known) / n).sum(1)) / known.shape[1]
    known, learned = known.mean(1), raw["learned"].mean(1)
    for k, colour in enumerate(_COLOURS):
        axes.plot(cosine, learned[:, k], color=colour, linewidth=1)
        axes.errorbar(
            cosine, known[:, k], _Z * error[:, k], fmt=".", color=colour, markersize=3, linewidth=1
        )
    axes.set_xlim(0, 1)
    axes.set_ylim(0, None)
    axes.set_title(material)
    axes.set_xlabel("cosine of incidence")
    axes.set_ylabel("albedo")
