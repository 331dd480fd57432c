"""The ranking over materials: mean, share of wins, spreads apart, and who may be bold."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from harness.analysis.combine import Estimate, over_seeds
from harness.analysis.ranking import standings
from harness.analysis.results import Results
from harness.report.parts import part
from harness.report.table import Cell, Table, embolden
from tests.report_results import MATERIALS, Made

SCENE = "studio-sphere"
LABELS = ["cosine", "improved-baseline", "neural-spline-flow", "tabulated"]


def made(folder: Path, **changes) -> Results:
    given = {"methods": LABELS, "measures": ("fit", "equal-spp", "equal-time")} | changes
    return Results.load(Made(**given).write(folder))


def by_label(results: Results, **options) -> dict:
    return {one.method.label: one for one in standings(results, SCENE, **options)}


def test_mean_and_share(tmp_path: Path) -> None:
    results = made(tmp_path, materials=MATERIALS)
    found = by_label(results)
    flow = found["neural-spline-flow"]
    logs = [
        math.log(
            results.number("equal-time", "speedup-equal-time", m, flow.method.label, SCENE).value
        )
        for m in MATERIALS
    ]
    assert flow.mean.value == pytest.approx(math.exp(sum(logs) / 12))
    assert flow.mean.low < flow.mean.value < flow.mean.high
    wins = sum(log > 0 for log in logs)  # cosine is far behind in what is made up
    assert flow.best.value == pytest.approx(wins / 12)
    shares = [one.best.value for one in found.values() if isinstance(one.best, Estimate)]
    assert sum(shares) == pytest.approx(1)
    assert found["tabulated"].best == "the ceiling does not compete"
    assert (found["improved-baseline"].mean.low, found["improved-baseline"].mean.high) == (1, 1)


def test_the_interval_over_materials_is_wider_than_that_of_the_measurements(
    tmp_path: Path,
) -> None:
    results = made(tmp_path, materials=MATERIALS)
    mean = by_label(results)["neural-spline-flow"].mean
    table = part("tables", "table2")(results)
    row = next(r for r in table.sections[0].rows if r.summary)
    same = row.cells[table.columns.index("neural-spline-flow")]
    assert math.log(mean.high / mean.low) > 2 * math.log(same.high / same.low)


def test_spreads_are_apart(tmp_path: Path) -> None:
    one = by_label(made(tmp_path / "one"))["cosine"]
    assert one.training == "one seed a fit: no training spread"
    assert one.render.value == pytest.approx(1.033, abs=0.005)  # [0.94, 1.07] of every record
    two = by_label(made(tmp_path / "two", seeds=(0, 1, 2)))["cosine"]
    assert isinstance(two.training, Estimate)
    assert two.training.low <= two.training.value <= two.training.high
    # The fixture's divergences differ between seeds by a quarter.
    assert two.training.value > two.render.value


def test_a_biased_method_is_best_nowhere(tmp_path: Path) -> None:
    results = made(tmp_path)
    out = by_label(results, biased=lambda material, method: method == "neural-spline-flow")
    assert out["neural-spline-flow"].best.value == 0
    assert isinstance(out["neural-spline-flow"].mean, Estimate)


def test_a_method_without_numbers_has_reasons(tmp_path: Path) -> None:
    results = made(
        tmp_path,
        fail={
            ("equal-time", "cosine", None): ("error", "no luck"),
            ("equal-time", "neural-spline-flow", "elephant-hide"): ("timeout", "slow"),
        },
    )
    found = by_label(results)
    assert found["cosine"].mean == "error: no luck"
    assert found["neural-spline-flow"].mean.note == "2 of 3 materials only"
    table = part("tables", "ranking")(results)
    assert isinstance(table, Table)
    rows = {row.label: row.cells for row in table.sections[0].rows}
    assert rows["cosine"][0].missing == "error: no luck"
    assert "2 of 3" in rows["neural-spline-flow"][0].warning
    assert not rows["neural-spline-flow"][0].bold


def test_the_table_has_a_section_for_each_scene(tmp_path: Path) -> None:
    results = made(tmp_path, scenes=(SCENE, "patch"), materials=MATERIALS)
    table = part("tables", "ranking")(results)
    assert [section.title for section in table.sections] == [SCENE, "patch"]
    assert [row.label for row in table.sections[0].rows] == LABELS
    best = {row.label: row.cells[1].text for row in table.sections[0].rows}
    assert best["cosine"].startswith("0%")
    assert sum(cell.bold for row in table.sections[0].rows for cell in row.cells) <= 1
    assert isinstance(part("tables", "ranking")(made(tmp_path / "none", measures=("fit",))), str)


def test_bold_only_where_the_interval_excludes_the_next() -> None:
    def bold(*cells: Cell) -> list[bool]:
        return [cell.bold for cell in embolden(list(cells), "high")]

    assert bold(Cell(2.0, 1.6, 2.4), Cell(1.5, 1.4, 1.59)) == [True, False]
    assert bold(Cell(2.0, 1.6, 2.4), Cell(1.5, 1.4, 1.6)) == [False, False]
    # Touching the value of the next is not enough: its interval counts too.
    assert bold(Cell(2.0, 1.6, 2.4), Cell(1.5, 1.2, 1.8)) == [False, False]


def test_seeds_are_averaged_with_students_t() -> None:
    from scipy import stats

    found = over_seeds([Estimate(math.exp(x), 1e-9, 1e9) for x in (0.0, 0.1, 0.4)])
    low, high = stats.t.interval(0.95, 2, 0.5 / 3, stats.sem([0.0, 0.1, 0.4]))
    assert (found.low, found.high) == pytest.approx((math.exp(low), math.exp(high)))
