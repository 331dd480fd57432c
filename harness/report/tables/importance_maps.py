"""Importance maps: smoothness, and the error after bilinear interpolation, by lobe."""

from __future__ import annotations

import numpy as np

from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table, embolden
from harness.report.tables.common import BOLD_LEGEND, as_baseline, circumstances
from harness.stats.intervals import geometric_mean, mean_interval

ORDER = 120
MEASURE = "importance-maps"
LOBES = (("broad", 0.25, 2.0), ("glossy", 0.02, 0.25), ("narrow", 0.0, 0.02))
"""By the effective share of the disk that a slice covers."""
_METRICS = (
    ("binned_error", "share of the probability in wrong cells after bilinear interpolation [1]"),
    ("gradient_mean", "mean gradient of the map [1]"),
    ("gradient_p99", "99th percentile of the gradient [1]"),
    ("cost", "transport cost: mean squared distance [1]"),
    ("evenness", "χ² of the map's points per degree of freedom [1]"),
)


def importance_maps(results: Results) -> Table | str:
    """A section per quantity and resolution: rows materials and lobes, columns kinds of map."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    resolutions = results.arrays(results.trials(MEASURE)[0])["resolutions"]
    methods = [m for m in results.methods if results.rows(MEASURE, None, m.label)]
    sections = []
    for metric, title in _METRICS:
        for i, n in enumerate(resolutions):
            last = i == len(resolutions) - 1
            if metric != "binned_error" and not last:
                continue
            heading = f"{title}, maps of {n} x {n}"
            rows = _rows(results, methods, metric, i)
            sections.append(Section(heading, rows, brief=False))
            if any(m.label == results.baseline for m in methods):
                rows = _rows(results, methods, metric, i, results.baseline)
                over = heading.replace(" [1]", "")
                sections.append(Section(f"{over}: over {results.baseline}", rows, brief=last))
    shares = ", ".join(f"{name} above {low:.0%}" for name, low, _ in LOBES[:-1])
    said = circumstances(results, MEASURE)
    return Table(
        name=MEASURE,
        title="Importance maps",
        caption=(
            "Maps from the unit square to the projected disk, of random slices. Gradients are "
            "norms of the derivative of the direction by the uniforms. Lobes by the effective "
            f"share of the disk that they cover: {shares}, narrow below. Ratios are geometric "
            f"means over the same slices. Lower is better. {said}"
        ).strip(),
        corner="material, lobe (slices)",
        columns=[m.label for m in methods],
        sections=sections,
        best="low",
        legend=[BOLD_LEGEND],
        measures=(MEASURE,),
    )


def _rows(
    results: Results, methods: list[MethodColumn], metric: str, i: int, over: str = ""
) -> list[Row]:
    """Means by lobe; with ``over``, of the ratios to that method's value on the same slice."""
    rows = []
    for material in results.materials:
        for lobe, low, high in LOBES:
            cells, count = [], 0
            for method in methods:
                trials = results.trials(MEASURE, material, method.label)
                if not trials:
                    why = results.why_missing(MEASURE, material, method.label)
                    cells.append(Cell(missing=why))
                    continue
                arrays = results.arrays(trials[0])
                mine = (arrays["spread"] >= low) & (arrays["spread"] < high)
                count = int(mine.sum())
                values = arrays[metric][mine, i]
                if not over:
                    cells.append(_cell(values))
                elif method.label == over:
                    cells.append(as_baseline("1", method))
                elif rivals := results.trials(MEASURE, material, over):
                    rival = results.arrays(rivals[0])[metric][mine, i]
                    cells.append(_ratio(values, rival))
                else:
                    cells.append(Cell(missing=results.why_missing(MEASURE, material, over)))
            if count:
                rows.append(Row(f"{material}, {lobe} ({count})", embolden(cells, "low")))
    return rows


def _ratio(values: np.ndarray, rival: np.ndarray) -> Cell:
    # The chi-square of a lobe within one cell is zero, whatever the map: nothing to compare.
    told = (values > 0) & (rival > 0)
    ratios = values[told] / rival[told]
    if len(ratios) < 2:
        return Cell(float(ratios[0])) if len(ratios) else Cell(missing="no such slice was drawn")
    return Cell(*geometric_mean(ratios), suffix="×")


def _cell(values: np.ndarray) -> Cell:
    if len(values) == 0:
        return Cell(missing="no such slice was drawn")
    if len(values) == 1:
        return Cell(float(values[0]))
    return Cell(*mean_interval(values))
