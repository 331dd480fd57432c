"""Importance maps as images, and the slices that come back from them (the paper's Figure 6)."""

from __future__ import annotations

import numpy as np

from harness.analysis.results import Results
from harness.report.figures.canvas import Canvas, Drawn, picture, sheet, wrapped
from harness.report.figures.style import styled
from harness.report.formats.short import short

ORDER = 90
MEASURE = "importance-maps"
_PANEL = 1.1
"""Inches."""


def importance_maps(results: Results, canvas: Canvas) -> list[Drawn] | str:
    """A row per material and slice: the slice, then of each kind the map and its reconstruction."""
    rows = [
        (material, k)
        for material in results.materials
        if (trials := results.trials(MEASURE, material))
        for k in range(len(results.arrays(trials[0])["map"]))
    ]
    if not rows:
        return f"no trial of the measure {MEASURE} ended well"
    methods = [m for m in results.methods if results.trials(MEASURE, None, m.label)]
    left, top, under, gap = 0.25, 0.35, 0.16, 0.06
    columns = 1 + 2 * len(methods)
    height = top + len(rows) * (_PANEL + under)
    with styled():
        figure, axes = sheet(left + columns * (_PANEL + gap), height)
        for r, (material, k) in enumerate(rows):
            y = height - top - r * (_PANEL + under) - _PANEL
            target = results.arrays(results.trials(MEASURE, material)[0])["target"][k]
            peak = float(np.quantile(target[target > 0], 0.98))

            def panel(image: np.ndarray, column: int, y: float = y) -> float:
                x = left + column * (_PANEL + gap)
                picture(axes, image, (x, y, _PANEL, _PANEL), origin="lower")
                return x + _PANEL / 2

            middle = panel(_lit(target, peak), 0)
            axes.text(left / 2, y + _PANEL / 2, material, rotation=90, ha="center", va="center")
            heads = [(middle, "slice")] if r == 0 else []
            for m, method in enumerate(methods):
                trials = results.trials(MEASURE, material, method.label)
                if not trials:
                    continue
                arrays = results.arrays(trials[0])
                one = panel(_coloured(arrays["map"][k]), 1 + 2 * m)
                two = panel(_lit(arrays["binned"][k], peak), 2 + 2 * m)
                said = (
                    f"gradient {short(arrays['gradient_mean'][k, -1])},"
                    f" p99 {short(arrays['gradient_p99'][k, -1])}"
                )
                axes.text(one, y - 0.01, said, ha="center", va="top", fontsize=6)
                said = f"error {short(arrays['binned_error'][k, -1])}"
                axes.text(two, y - 0.01, said, ha="center", va="top", fontsize=6)
                if r == 0:
                    heads += [(one, method.label), (two, "interpolated, binned")]
            for x, text in heads:
                axes.text(x, height - top + 0.03, wrapped(text), ha="center", va="bottom")
        return [
            canvas.save(
                figure,
                MEASURE,
                "Importance maps",
                "For random slices: the slice, and of each kind of map the map itself (red: x, "
                "green: y of the direction that a point of the unit square is sent to) and what "
                "comes back when uniform points go through the bilinearly interpolated map and "
                "are counted. Under the map the mean and the 99th percentile of its gradient; "
                "under the counts the share of the probability that is in the wrong cell.",
            )
        ]


def _coloured(wo: np.ndarray) -> np.ndarray:
    """Directions [R, R, 2] as red and green."""
    red, green = (np.clip((wo[..., i] + 1) / 2, 0, 1) for i in (0, 1))
    return np.stack([red, green, 0 * red], -1)


def _lit(mass: np.ndarray, peak: float) -> np.ndarray:
    """Masses as grey, the square root of their share of ``peak``."""
    grey = np.sqrt(np.clip(mass / peak, 0, 1))
    return np.stack([grey] * 3, -1)
