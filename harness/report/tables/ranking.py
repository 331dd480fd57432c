"""The methods over all materials: mean, share of wins, and where the spread comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from harness.analysis import numbers
from harness.analysis.bias import bias_warnings
from harness.analysis.combine import Estimate
from harness.analysis.ranking import MEASURE, Standing, standings
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table, embolden
from harness.report.tables.common import cell, circumstances

ORDER = 80
Warnings = Callable[[str, str, str], str]
"""(material, method, scene) -> what makes the method's number doubtful."""
_COLUMNS = ["geometric mean", "best on", "render spread", "training spread"]
_LEGEND = (
    "Geometric mean: of the speed-ups over materials and training seeds as samples of more such; "
    "its interval is wider than that of the same materials measured again. In bold the best of "
    "that column, where its interval lies clear of every other's.",
    "Best on: share of the materials, with an interval for the noise of the measurement and for "
    "other materials (Jeffreys). Spread: factor of one standard deviation of one speed-up, from "
    "the noise of its rounds, and from the seed of its fit beyond that noise.",
)


def ranking(results: Results) -> Table | str:
    """Sections scenes; rows methods."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    warnings = bias_warnings(results)
    scenes = results.scenes(MEASURE)
    sections = []
    for scene in scenes:
        found = standings(results, scene, lambda m, label, at=scene: bool(warnings(m, label, at)))
        rows = [[*_cells(results, one, scene, warnings)] for one in found]
        first = embolden([row[0] for row in rows], "high")
        sections.append(
            Section(
                scene if len(scenes) > 1 else "",
                [
                    Row(one.method.label, [mean, *row[1:]])
                    for one, mean, row in zip(found, first, rows, strict=True)
                ],
            )
        )
    said = circumstances(results, MEASURE, timed=True)
    return Table(
        name="ranking",
        title="Ranking over materials",
        caption=(
            f"Speed-up over {results.baseline or 'the baseline'} at equal time, over "
            f"{len(results.materials)} materials."
            f"{f' Scene: {scenes[0]}.' if len(scenes) == 1 else ''} {said}"
        ).strip(),
        corner="method",
        columns=_COLUMNS,
        sections=sections,
        legend=list(_LEGEND),
        measures=(MEASURE,),
    )


def _cells(results: Results, one: Standing, scene: str, warnings: Warnings) -> list[Cell]:
    method = one.method
    biased = [m for m in results.materials if warnings(m, method.label, scene)]
    doubt = [f"biased on {', '.join(biased)}"] if biased else []
    if isinstance(one.mean, Estimate) and one.mean.note:
        doubt.append(one.mean.note)
    mean = cell(one.mean, method, "×", "; ".join(doubt), bool(biased))
    if method.label == results.baseline and not mean.missing:
        mean = replace(mean, text="1×")
    return [
        mean,
        _said(one.best, method, lambda v: f"{v:.0%}"),
        _said(one.render, method, _factor),
        _said(one.training, method, _factor),
    ]


def _said(number: Estimate | str, method: MethodColumn, say: Callable[[float], str]) -> Cell:
    if isinstance(number, str):
        return Cell(missing=number, ceiling=method.ceiling)
    text = say(number.value)
    if number.has_interval:
        text += f" [{say(number.low)}, {say(number.high)}]"
    return Cell(number.value, number.low, number.high, text=text, ceiling=method.ceiling)


def _factor(value: float) -> str:
    return f"×{numbers.plain(value, 3 if value < 1.1 else 2)}"
