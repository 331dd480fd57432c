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
    totals = {label: _totals(line) for label, line in found.lines.items()}
    fair = [label for label in totals if label not in barred]
    return {
        "best": [_best({k: totals[k][i] for k in fair}, names) for i in range(len(SAMPLES))]
        if fair
        else [],
        "lines": [
            {
                "method": names.methods.index(label),
                "seconds": _ends(total),
                "mark": found.lines[label].mark,
            }
            for label, total in totals.items()
        ],
        "out": found.missing | barred,
    }


def _totals(line: CostLine) -> NDArray:
    """Seconds [N, 1 + R] at each stop: the value, then its draws."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([line.total(samples) for samples in SAMPLES])


def _best(totals: dict[str, NDArray], names: Names) -> dict[str, Any]:
    """The fastest, the next, and how far they are apart with its interval."""
    ranked = sorted(totals, key=lambda label: totals[label][0])
    first = totals[ranked[0]]
    draws = np.stack([totals[label][1:] for label in ranked])
    made: dict[str, Any] = {
        "method": names.methods.index(ranked[0]),
        "surest": number(float((draws.argmin(0) == 0).mean()), 3),
        "seconds": _said_seconds(first),
    }
    if len(ranked) > 1:
        made["next"] = names.methods.index(ranked[1])
        made |= _margin(first, totals[ranked[1]])
    return made


def _margin(first: NDArray, second: NDArray) -> dict[str, Any]:
    """How many times as long the second takes; a tie where that may be once."""
    known = np.isfinite(first)
    # Draws of a variance that is hardly known are infinite: without them nothing is covered.
    if not known[0] or known[1:].mean() < _ENOUGH:
        return {"margin": "not resolved", "tie": True}
    margin = second[known] / first[known]
    low, high = np.percentile(margin[1:], [2.5, 97.5])
    value, interval = numbers.with_interval(float(margin[0]), float(low), float(high))
    return {"margin": f"{value}× {interval}".strip(), "tie": bool(low <= 1)}


def _said_seconds(total: NDArray) -> str:
    low, high = np.percentile(total[1:], [2.5, 97.5])
    value, *ends = (numbers.duration(float(v)) for v in (total[0], low, high))
    return value if ends[0] == ends[1] else f"{value} [{ends[0]}, {ends[1]}]"


def _ends(totals: NDArray) -> list[list[float | str | None]]:
    """Value, low and high at each stop."""
    low, high = np.percentile(totals[:, 1:], [2.5, 97.5], axis=1)
    ends = zip(totals[:, 0], low, high, strict=True)
    return [[number(float(v), _DIGITS) for v in three] for three in ends]


def _training(results: Results, scene: str, material: str) -> dict[str, Any]:
    """How many trainings there are, and which method was first per sample with each."""
    seeds = len(set(results.training.values()))
    winners = winners_by_training(results, "table2", scene, material) if seeds > 1 else {}
    return {"seeds": seeds, "first": dict(winners)}
