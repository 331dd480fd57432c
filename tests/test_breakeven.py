"""Break-even: total time as lines, their crossings, and the table and figure of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from harness.analysis.breakeven import Costs, costs
from harness.analysis.results import Results
from harness.measures.base import Outcome
from harness.report.figures.breakeven import breakeven as figure
from harness.report.figures.canvas import Canvas
from harness.report.formats.csv import csv
from harness.report.formats.markdown import markdown
from harness.report.parts import part
from harness.report.published.neusample import neusample
from harness.report.table import Table
from tests.report_results import METHODS, Made

SCENE = "studio-sphere"
LABELS = ["cosine", "improved-baseline", "two-lobe", "neural-spline-flow", "tabulated"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Made(
        methods=LABELS,
        measures=("fit", "equal-spp", "equal-time"),
        report={"tables": ["table2", "breakeven"], "figures": ["breakeven"]},
        fail={("equal-time", "two-lobe", "elephant-hide"): ("error", "no luck")},
    ).write(tmp_path_factory.mktemp("breakeven"))


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return Results.load(folder)


def found(results: Results, material: str = "veined-marble", shipped: bool = False) -> Costs:
    answer = costs(results, material, SCENE, shipped)
    assert isinstance(answer, Costs), answer
    return answer


def table_of(results: Results, name: str = "breakeven") -> Table:
    table = part("tables", name)(results)
    assert isinstance(table, Table), table
    return table


def test_a_line_is_made_of_what_is_recorded(results: Results) -> None:
    line = found(results).lines["neural-spline-flow"]
    at = ("veined-marble", "neural-spline-flow", SCENE)

    def number(measure: str, metric: str, method: str = at[1]) -> float:
        scene = "" if measure == "fit" else SCENE
        return results.number(measure, metric, at[0], method, scene).value

    assert line.fixed[0] == pytest.approx(
        number("fit", "fit-seconds") + number("fit", "load-seconds")
    )
    variance = number("equal-spp", "variance") / number(
        "equal-spp", "variance", "improved-baseline"
    )
    assert line.slope[0] == pytest.approx(
        variance * number("equal-time", "seconds-per-spp") / 32**2, rel=1e-3
    )
    assert line.total(1e6)[0] == pytest.approx(line.fixed[0] + 1e6 * line.slope[0])


def test_crossing_is_where_total_times_agree(results: Results) -> None:
    seen = []
    for material in results.materials:
        for shipped in (False, True):
            lines = found(results, material, shipped).lines
            base = lines["improved-baseline"]
            for line in lines.values():
                crossing = line.against(base)
                if crossing.kind not in ("from", "until"):
                    continue
                seen.append(crossing.kind)
                at = crossing.at
                assert crossing.low <= at <= crossing.high
                assert line.total(at)[0] == pytest.approx(base.total(at)[0])
                ahead = [line.total(n)[0] < base.total(n)[0] for n in (0.5 * at, 2 * at)]
                assert ahead == ([False, True] if crossing.kind == "from" else [True, False])
    assert {"from", "until"} <= set(seen)


def test_shipped_methods_only_load(results: Results) -> None:
    at = ("veined-marble", "neural-spline-flow")
    load = results.number("fit", "load-seconds", *at).value
    assert found(results, shipped=True).lines[at[1]].fixed[0] == pytest.approx(load)


def test_draws_are_the_same_every_time(results: Results) -> None:
    first, again = found(results), found(results)
    for label, line in first.lines.items():
        assert np.array_equal(line.slope, again.lines[label].slope)


class HardlyKnown(Made):
    """Two batches of ``two-lobe`` that do not know its variance."""

    def _equal_spp(self, random, chi2, variance, seconds, material, method) -> Outcome:
        outcome = super()._equal_spp(random, chi2, variance, seconds, material, method)
        if method == "two-lobe":
            outcome.arrays["batch_variance"] = np.array([1e-30, 1e30])
        return outcome


def test_a_variance_beyond_all_numbers_never_pays(tmp_path: Path) -> None:
    """Some draws of it have an exponential that overflows."""
    made = HardlyKnown(methods=LABELS, measures=("fit", "equal-spp", "equal-time"))
    lines = found(Results.load(made.write(tmp_path))).lines
    line = lines["two-lobe"]
    assert np.isinf(line.slope).any() and not np.isnan(line.slope).any()
    crossing = line.against(lines["improved-baseline"])
    assert not math.isnan(crossing.low) and math.isinf(crossing.high)


def test_a_method_without_a_time_has_a_reason(results: Results) -> None:
    answer = found(results, "elephant-hide")
    assert answer.missing["two-lobe"] == "error: no luck"
    table = table_of(results)
    row = next(r for r in table.sections[0].rows if r.label == "elephant-hide")
    assert row.cells[table.columns.index("two-lobe")].missing == "error: no luck"


def test_without_the_baseline_there_is_nothing_to_count_in(tmp_path: Path) -> None:
    made = Made(
        methods=LABELS,
        measures=("fit", "equal-spp", "equal-time"),
        fail={("equal-time", "improved-baseline", None): ("timeout", "too slow")},
    )
    answer = costs(Results.load(made.write(tmp_path)), "veined-marble", SCENE)
    assert isinstance(answer, str) and "timeout: too slow" in answer


def test_the_table_says_never_until_and_from_the_start(results: Results) -> None:
    table = table_of(results)
    titles = [section.title for section in table.sections]
    assert titles == [
        f"against {rival}, {how}"
        for how in ("fitted here", "shipped with its fit")
        for rival in ("improved-baseline", "cosine")
    ]
    assert [section.brief for section in table.sections] == [True, False, False, False]
    cells = {
        (row.label, column): cell
        for row in table.sections[0].rows
        for column, cell in zip(table.columns, row.cells, strict=True)
    }
    assert cells["veined-marble", "improved-baseline"].text == "·"
    cosine = cells["veined-marble", "cosine"]
    assert cosine.text.startswith("until ") and 0 < cosine.value < math.inf
    assert cells["veined-marble", "tabulated"].ceiling
    assert "Break-even" in markdown(table) and csv(table).count("\n") == 1 + 4 * 3 * 5


def test_without_times_the_table_says_why(tmp_path: Path) -> None:
    folder = Made(measures=("fit", "pdf"), methods=LABELS).write(tmp_path)
    said = part("tables", "breakeven")(Results.load(folder))
    assert isinstance(said, str) and "equal-time or cost" in said


def test_the_figure_is_drawn(results: Results, tmp_path: Path) -> None:
    (drawn,) = figure(results, Canvas(tmp_path))
    assert drawn.png.stat().st_size > 10_000
    assert "improved-baseline" in drawn.caption


# --- the paper beside us, and disturbed timings ---------------------------------------------------


def test_published_figures_are_the_papers() -> None:
    paper = neusample()
    flow = paper.speed_ups("neural-spline-flow")
    assert len(flow) == 12 and flow["Moroccan"] == 6.78
    # What the text says of them: "from 1.28x to 6.78x, with a mean of 2.58x" over both of its own
    # recommended methods is the better of the two for each material.
    mixture = paper.speed_ups("histogram-mixture")
    best = [max(flow[m], mixture[m]) for m in flow]
    assert (min(best), max(best)) == (1.28, 6.78)
    assert paper.speed_ups("native") == {}
    assert set(paper.table2["columns"]) == set(paper.methods)
    assert all(len(row) == len(paper.table2["columns"]) for row in paper.table2["rows"].values())
    assert set(paper.table1["rendering"]) == set(paper.table1["sampling"]) <= set(paper.methods)
    assert "2023" in paper.citation


def test_table2_keeps_the_paper_apart(results: Results) -> None:
    table = table_of(results, "table2")
    ours, theirs = table.sections
    assert "as published" in theirs.title
    assert {row.label for row in ours.rows}.isdisjoint(row.label for row in theirs.rows)
    values = dict(zip(table.columns, theirs.rows[0].cells, strict=True))
    assert (theirs.rows[0].label, values["two-lobe"].text) == ("Egyptian", "1.87×")
    assert "not in Table 2" in values["tabulated"].missing
    # The mean of ours does not know of theirs.
    mean = next(row for row in ours.rows if row.summary)
    assert mean.cells[0].value == pytest.approx(
        np.exp(np.mean([np.log(r.cells[0].value) for r in ours.rows if not r.summary]))
    )


def test_a_disturbed_timing_is_marked_and_does_not_win(results: Results) -> None:
    frame = results.frame.copy()
    at = (frame["measure"] == "equal-time") & (frame["method"] == "neural-spline-flow")
    mark = frame[at & (frame["metric"] == "seconds-per-spp")].copy()
    mark["metric"], mark["value"] = "disturbed", 1.0
    mark["reason"] = "disturbed: interval wider than 10%: render 31% after 24 rounds"
    import pandas as pd

    marked = replace(results, frame=pd.concat([frame, mark]))
    for name in ("table2", "timing", "breakeven"):
        table = table_of(marked, name)
        warned = [c.warning for s in table.sections for r in s.rows for c in r.cells if c.warning]
        assert any("31% after 24 rounds" in warning for warning in warned), name
    cells = table_of(marked, "table2").sections[0].rows[0].cells
    column = table_of(marked, "table2").columns.index("neural-spline-flow")
    assert not cells[column].bold
    mean = next(r for r in table_of(marked, "table2").sections[0].rows if r.summary)
    assert "disturbed on" in mean.cells[column].warning


def test_every_method_of_the_fixture_is_known() -> None:
    assert set(LABELS) <= set(METHODS)
