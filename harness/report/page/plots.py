"""Series of the interactive plots: convergence, accuracy against time, densities."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.analysis.pareto import CHARTS
from harness.analysis.records.convergence import curve_of
from harness.analysis.records.slices import divergences
from harness.analysis.results import Results
from harness.report.formats.short import short
from harness.report.page.names import Names
from harness.report.page.plain import estimate, number, packed, series
from harness.report.series.pareto import Point, panels
from harness.report.series.slices import BELOW_ZERO

_DENSITY_BUDGET = 2_000_000
"""Characters that densities may take on a page; materials beyond it are left to the figures."""
_DRAWN = 300
"""Points of a density's samples that are shown."""


def convergence(results: Results) -> list[dict[str, Any]]:
    """A curve per trial; ``low`` and ``high`` are bands of the error."""
    names, curves = Names(results), []
    for key in results.trials("convergence"):
        labels, found = results.stored(key).labels, curve_of(results.arrays(key))
        mse = np.asarray(found["mse"], float)
        curve: dict[str, Any] = {
            "trial": names.trials[key],
            "method": names.methods.index(labels["method"]),
            "material": names.materials.index(labels["material"]),
            "scene": names.scenes.index(labels["scene"]) if labels["scene"] else -1,
            "spp": series(found["spp"]),
            "seconds": series(found["seconds"]),
            # An error below the reference's own noise may be negative: it has no logarithm.
            "mse": [number(float(v)) if v > 0 else None for v in mse],
        }
        for end in ("low", "high"):
            for name in ("mse", "seconds"):
                if f"{name}_{end}" in found:
                    curve[f"{name}_{end}"] = series(found[f"{name}_{end}"])
        if any(v is not None for v in curve["mse"]):
            curves.append(curve)
    return curves


def charts(results: Results) -> list[dict[str, Any]]:
    """Accuracy against time: a chart per pair of numbers and scene, with a panel per material."""
    names, made = Names(results), []
    for chart in CHARTS:
        scenes = chart.scenes(results)
        for scene in scenes:
            found = panels(results, chart, scene)
            if not found:
                continue
            where = f" in {scene}" if scene and chart.in_scene(results) else ""
            made.append(
                {
                    "title": f"{chart.title}{f': {scene}' if len(scenes) > 1 else ''}",
                    "caption": chart.caption.format(where=where),
                    "x": chart.x_title,
                    "y": chart.y_title,
                    "panels": [
                        {
                            "title": title,
                            "points": [_point(p, names) for p in panel.points],
                            "levels": [_point(p, names) for p in panel.levels],
                            "off": panel.off,
                        }
                        for title, panel in found.items()
                    ],
                }
            )
    return made


def _point(point: Point, names: Names) -> dict[str, Any]:
    base = point.family.base.label
    made: dict[str, Any] = {
        "method": names.methods.index(point.label),
        "family": names.methods.index(base) if base in names.methods else -1,
        "knob": "" if point.label == base else point.family.short(point.label),
        "x": estimate(point.x),
        "y": estimate(point.y),
    }
    if point.standing is not None:
        made |= {"place": point.standing.place, "sure": number(point.standing.membership, 3)}
    return made


def densities(results: Results) -> dict[str, Any]:
    """Target and pdf of each method on a grid, the root of their share of the target's peak in
    8 bits; points of samples. ``left`` names the materials that had no room."""
    names = Names(results)
    made: list[dict[str, Any]] = []
    left, size = [], 0
    for material in results.materials:
        trials = [t for t in results.trials("slices", material) if "pdf" in results.arrays(t)]
        if not trials:
            continue
        target = results.arrays(trials[0])["target"]
        peaks = [_peak(one) for one in target]
        entry = {
            "material": names.materials.index(material),
            "peaks": series(peaks),
            "target": packed(_bytes(target, peaks)),
            "methods": [_density(results, names, trial, peaks) for trial in trials],
        }
        here = sum(len(d["grid"]["data"]) for d in entry["methods"])
        if size + here > _DENSITY_BUDGET:
            left.append(material)
            continue
        size += here
        made.append(entry)
    return {"materials": made, "left": left, "belowZero": BELOW_ZERO}


def _density(results: Results, names: Names, trial: str, peaks: list[float]) -> dict[str, Any]:
    arrays = results.arrays(trial)
    kl, mse = divergences(arrays)
    made = {
        "trial": names.trials[trial],
        "method": names.methods.index(results.stored(trial).labels["method"]),
        "grid": packed(_bytes(arrays["pdf"], peaks)),
        "kl": [short(v) for v in kl],
        "mse": [short(v) for v in mse],
        "below": [bool(v < 0) for v in kl],
    }
    if "samples" in arrays:
        # Directions [K, S, 2]; what is off the disk is not a direction, and is counted.
        made["samples"] = [series(one[:_DRAWN].ravel(), 3) for one in arrays["samples"]]
    return made


def _peak(target: np.ndarray) -> float:
    inside = target[np.isfinite(target)]
    return float(np.quantile(inside, 0.999)) or float(inside.max()) or 1.0


def _bytes(density: np.ndarray, peaks: list[float]) -> np.ndarray:
    """[K, n, n] in 8 bits: 0 off the disk, else 1 to 255 for the root of the share of the peak."""
    share = np.sqrt(np.clip(density / np.array(peaks)[:, None, None], 0, 1))
    return np.where(np.isfinite(density), 1 + np.round(254 * share), 0).astype(np.uint8)
