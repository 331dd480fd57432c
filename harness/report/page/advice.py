"""Which method to use for so many samples, for a slider of these; and total times to an error."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.analysis import numbers
from harness.analysis.bias import bias_warnings
from harness.analysis.breakeven import CostLine, Costs, costs, timed_scenes
from harness.analysis.results import Results
from harness.report.page.answer import winners_by_training
from harness.report.page.names import Names
from harness.report.page.plain import number
from harness.stats.intervals import interval_of_draws

SAMPLES = tuple(float(2**i * 1000**k) for k in (1, 2, 3) for i in range(10))
"""Stops of the slider: 1 k, 2 k, ... 512 G samples of the baseline over all pixels."""
_DIGITS = 4
_ENOUGH = 0.999
"""Share of draws that have to be finite."""


def advice(results: Results) -> dict[str, Any]:
    """``cells`` by material and scene: at each stop the fastest method, and everyone's seconds."""
    names, warnings = Names(results), bias_warnings(results)
    cells = []
    for scene in timed_scenes(results):
        for material in results.materials:
            at = {
                "material": names.materials.index(material),
                "scene": names.scenes.index(scene) if scene in names.scenes else -1,
                "training": _training(results, scene, material),
            }
            for shipped in (False, True):
                found = costs(results, material, scene, shipped)
                if isinstance(found, str):
                    at["why"] = found
                    break
                barred = {
                    label: "the ceiling: too large to be used" if line.method.ceiling else doubt
                    for label, line in found.lines.items()
                    if (doubt := warnings(material, label, scene)) or line.method.ceiling
                }
                at["shipped" if shipped else "fitted"] = _cell(found, barred, names)
            cells.append(at)
    return {
        "samples": [int(n) for n in SAMPLES],
        "said": [_count(n) for n in SAMPLES],
        "reference": results.baseline,
        "cells": cells,
    }


def _count(samples: float) -> str:
    """``64 M``: stops are whole thousands, millions or billions."""
    value, suffix = numbers.count(samples).split(" ")
    return f"{float(value):g} {suffix}"


def _cell(found: Costs, barred: dict[str, str], names: Names) -> dict[str, Any]:
    stops = np.array(SAMPLES)
    seconds = {label: line.totals(stops).T for label, line in found.lines.items()}
    fair = {label: line for label, line in found.lines.items() if label not in barred}
    return {
        "best": [
            _best(fair, n, {k: seconds[k][i] for k in fair}, names) for i, n in enumerate(stops)
        ]
        if fair
        else [],
        "lines": [
            {
                "method": names.methods.index(label),
                "seconds": [[number(float(v), _DIGITS) for v in three] for three in at],
                "mark": found.lines[label].mark,
            }
            for label, at in seconds.items()
        ],
        "out": found.missing | barred,
    }


def _best(
    lines: dict[str, CostLine], samples: float, seconds: dict[str, NDArray], names: Names
) -> dict[str, Any]:
    """The fastest, the next, and how far they are apart with its interval.

    ``seconds``: of each, the value and the ends of its interval.
    """
    ranked = sorted(lines, key=lambda label: seconds[label][0])
    with np.errstate(over="ignore", invalid="ignore"):
        totals = np.stack([lines[label].total(samples) for label in ranked])
    made: dict[str, Any] = {
        "method": names.methods.index(ranked[0]),
        "surest": number(float((totals[:, 1:].argmin(0) == 0).mean()), 3),
        "seconds": numbers.duration_with_interval(*seconds[ranked[0]]),
    }
    if len(ranked) > 1:
        made["next"] = names.methods.index(ranked[1])
        made |= _margin(totals[0], totals[1])
    return made


def _margin(first: NDArray, second: NDArray) -> dict[str, Any]:
    """How many times as long the second takes; a tie where that may be once."""
    known = np.isfinite(first)
    # Draws of a variance that is hardly known are infinite: without them nothing is covered.
    if not known[0] or known[1:].mean() < _ENOUGH:
        return {"margin": "not resolved", "tie": True}
    margin = second[known] / first[known]
    low, high = interval_of_draws(margin[1:])
    value, interval = numbers.with_interval(float(margin[0]), float(low), float(high))
    return {"margin": f"{value}× {interval}".strip(), "tie": bool(low <= 1)}


def _training(results: Results, scene: str, material: str) -> dict[str, Any]:
    """How many trainings there are, and which method was first per sample with each."""
    seeds = len(set(results.training.values()))
    winners = winners_by_training(results, "table2", scene, material) if seeds > 1 else {}
    return {"seeds": seeds, "first": dict(winners)}
