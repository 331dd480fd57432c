"""Tables: the best of a row, warnings, what is missing."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from harness.analysis.bias import bias_warnings, corrected_p
from harness.analysis.combine import Estimate
from harness.analysis.results import Results
from harness.report import write as reports
from harness.report.parts import part
from harness.report.table import Cell, Table, embolden
from tests.report_reading import cell_of, printed, table_of
from tests.report_results import MATERIALS, METHODS, Made

# --- bold ----------------------------------------------------------------------------------------


def bold(cells: list[Cell], best: str) -> list[bool]:
    return [cell.bold for cell in embolden(cells, best)]


def test_bold_needs_an_interval_clear_of_all_others():
    clear, near, low = Cell(3.0, 2.8, 3.2), Cell(2.9, 2.7, 3.1), Cell(1.0, 0.9, 1.1)
    assert bold([clear, low], "high") == [True, False]
    assert bold([clear, low], "low") == [False, True]
    assert bold([clear, low], "") == [False, False]
    assert bold([clear, near, low], "high") == [False, False, False]
    assert bold([Cell(3.0), low], "high") == [False, False]
    assert bold([clear], "high") == [False]
    # The best number overlaps not the second but the third, whose interval is wide.
    wide = Cell(1.5, 0.1, 9.0)
    assert bold([clear, Cell(2.0, 1.9, 2.1), wide], "high") == [False, False, False]


def test_ceilings_warnings_and_gaps_do_not_compete():
    winner = Cell(2.0, 1.9, 2.1)
    cells = [
        Cell(9.0, 8.9, 9.1, ceiling=True),
        Cell(8.0, 7.9, 8.1, warning="differs", biased=True),
        Cell(missing="error"),
        Cell(math.inf),
        winner,
        Cell(1.0, 0.9, 1.1),
    ]
    assert bold(cells, "high") == [False, False, False, False, True, False]


def test_a_disturbed_number_wins_nothing_and_stands_in_the_way():
    winner, rest = Cell(2.0, 1.9, 2.1), Cell(1.0, 0.9, 1.1)
    better = Cell(2.5, 2.2, 2.8, warning="disturbed: interval wider than 10%")
    worse = Cell(1.5, 1.2, 1.8, warning="disturbed: interval wider than 10%")
    assert bold([winner, rest, better], "high") == [False, False, False]
    assert bold([winner, rest, worse], "high") == [True, False, False]
    assert bold([winner, rest, replace(worse, missing="error")], "high") == [True, False, False]


# --- the tables ----------------------------------------------------------------------------------


def test_table2_has_daggers_warnings_and_the_ceiling_last(failing: Path):
    table = table_of(failing, "table2")
    assert table.columns[-1] == "tabulated"
    assert table.columns[:4] == list(METHODS)[:4]
    assert cell_of(table, "veined-marble", "blinn-phong").missing == "error: it_broke & burned: 50%"
    assert "unsupported" in cell_of(table, "quilted-satin", "neural-spline-flow").missing
    for row, said in (("elephant-hide", "biased"), ("geometric mean", "biased on elephant-hide")):
        found = cell_of(table, row, "fan-baseline")
        assert found.biased and said in found.warning
    assert not cell_of(table, "veined-marble", "fan-baseline").biased
    assert "2 of 3" in cell_of(table, "geometric mean", "neural-spline-flow").warning
    baseline = cell_of(table, "elephant-hide", "improved-baseline")
    assert (baseline.parts, baseline.value) == (("1×", ""), 1.0)
    assert cell_of(table, "geometric mean", "improved-baseline").parts == ("1×", "")
    for said in ("8 interleaved rounds", "rofile quick", "Example CPU", "studio-sphere"):
        assert said in table.caption
    assert not any(c.bold for r in table.sections[0].rows for c in r.cells if c.ceiling)


def test_geometric_mean_row_is_that_of_the_column(failing: Path):
    table = table_of(failing, "table2")
    values = [cell_of(table, m, "cosine").value for m in MATERIALS[:3]]
    mean = cell_of(table, "geometric mean", "cosine")
    assert mean.value == pytest.approx(float(np.exp(np.mean(np.log(values)))))
    assert mean.low < mean.value < mean.high


def test_bias_is_corrected_over_the_whole_table(failing: Path):
    results = Results.load(failing)
    corrected = corrected_p(results)
    key = ("elephant-hide", "fan-baseline", "studio-sphere")
    assert corrected[key] == pytest.approx(1e-12 * len(corrected))
    table = table_of(failing, "bias")
    cell = cell_of(table, "elephant-hide", "fan-baseline")
    assert cell.parts[0] == "<0.001" and "z = 12.3" in cell.warning
    assert f"1 of {len(corrected)}" in table.caption
    assert "1 differed at first, and has the p-value of new renders" in table.caption


def test_a_tail_that_is_not_resolved_leaves_bias_undecided(failing: Path):
    """Renders without the rare heavy samples differ from the reference, and are no proof."""
    results = Results.load(failing)
    before = corrected_p(results)
    frame = results.frame
    cell = (frame["method"] == "fan-baseline") & (frame["material"] == "elephant-hide")
    row = frame[cell & (frame["metric"] == "bias-p")].assign(metric="tail-resolved")
    for value, there in ((1.0, True), (0.0, False)):
        tail = row.assign(value=value, reason="the tail of its terms has index 1.39")
        told = replace(results, frame=pd.concat([frame, tail], ignore_index=True))
        found = corrected_p(told)
        key = ("elephant-hide", "fan-baseline", "studio-sphere")
        assert (key in found) == there and len(found) == len(before) - (not there)
        shown = cell_of(part("tables", "bias")(told), "elephant-hide", "fan-baseline")
        assert bool(shown.warning) == there
        assert there or shown.missing == "not decided: the tail of its terms has index 1.39"
        assert bool(bias_warnings(told)(*key)) == there


def test_pdf_sections_and_shares_without_contest(failing: Path):
    table = table_of(failing, "pdf")
    assert [s.title.split()[0] for s in table.sections][:2] == ["KL(p*", "χ²"]
    assert "64 held-out conditions" in table.caption
    shares = next(s for s in table.sections if "invalid" in s.title)
    assert not any(c.bold for r in shares.rows for c in r.cells)


def test_timing_gives_both_units(failing: Path):
    table = table_of(failing, "timing")
    per_spp, per_sample = (cell_of(table, "cosine", c) for c in ("ms per spp", "ns per sample"))
    assert per_sample.value == pytest.approx(per_spp.value * 1e6 / 32**2, rel=1e-6)
    assert per_sample.value == pytest.approx(95, rel=0.05)
    assert cell_of(table, "cosine", "parameters").parts[0] == "0"
    assert "32 × 32 pixels" in table.caption


def test_status_joins_what_failed_alike(failing: Path):
    table = table_of(failing, "status")
    assert len(table.sections[0].rows) == 2
    assert "fit, pdf, equal-spp" in cell_of(table, "quilted-satin", "measure").text
    assert "1 error" in table.caption and "6 unsupported" in table.caption


def test_equal_spp_without_a_timed_measure(tmp_path: Path):
    folder = Made(measures=("equal-spp",)).write(tmp_path)
    table = table_of(folder, "equal-spp")
    results = Results.load(folder)
    pair = [
        results.number("equal-spp", "variance", "brocade", m, "studio-sphere")
        for m in ("improved-baseline", "cosine")
    ]
    assert all(isinstance(p, str) for p in pair)  # not one of the three materials
    pair = [
        results.number("equal-spp", "variance", "veined-marble", m, "studio-sphere")
        for m in ("improved-baseline", "cosine")
    ]
    cell = cell_of(table, "veined-marble", "cosine")
    assert cell.value == pytest.approx(pair[0].value / pair[1].value)
    assert cell.low < cell.value < cell.high
    assert isinstance(part("tables", "table2")(results), str)


def test_two_scenes_and_two_seeds(tmp_path: Path):
    folder = Made(
        methods=["cosine", "improved-baseline", "native"],
        scenes=("studio-sphere", "patch"),
        seeds=(0, 1),
        measures=("fit", "equal-spp", "equal-time"),
    ).write(tmp_path)
    table = table_of(folder, "table2")
    assert [s.title for s in table.sections][:2] == ["studio-sphere", "patch"]
    assert "2 training seeds" in table.caption
    timing = table_of(folder, "timing")
    assert "ms per spp patch" in timing.columns


def test_a_failed_seed_is_said(tmp_path: Path):
    made = Made(materials=["suede"], methods=["cosine"], seeds=(0, 1), measures=("pdf",))
    folder = made.write(tmp_path)
    results = Results.load(folder)
    frame = results.frame
    second = frame["seed"] == 1
    frame.loc[second, "status"], frame.loc[second, "reason"] = "timeout", "too slow"
    number = replace(results, frame=frame).number("pdf", "kl", "suede", "cosine")
    assert isinstance(number, Estimate) and number.note == "1 of 2 seeds only; timeout: too slow"


def test_machines_are_not_compared_in_silence(tmp_path: Path):
    made = Made(materials=["suede"], measures=("equal-time",))
    made.write(tmp_path)
    other = Made(materials=["brocade"], measures=("equal-time",), machine={"cpu": "Other"})
    other.write(tmp_path / "other")
    mixed = Results.load(tmp_path)
    extra = Results.load(tmp_path / "other")
    both = replace(
        mixed,
        frame=pd.concat([mixed.frame, extra.frame]),
        plan=mixed.plan | {"trials": mixed.plan["trials"] + extra.plan["trials"]},
        found=mixed.found | extra.found,
    )
    table = part("tables", "timing")(both)
    assert isinstance(table, Table) and "not to be compared" in table.caption


def test_unfinished_runs_are_counted_not_listed(tmp_path: Path):
    folder = Made(not_run=("equal-time", "slices")).write(tmp_path)
    table = table_of(folder, "status")
    assert "30 not run yet" in table.caption and not table.sections
    assert "not run yet" in cell_of(table_of(folder, "table2"), MATERIALS[0], "cosine").missing


def test_everything_failed(tmp_path: Path):
    folder = Made(fail={(None, None, None): ("error", "no luck")}, materials=MATERIALS[:3]).write(
        tmp_path
    )
    said: list[str] = []
    files = reports.load(folder).write(said.append)
    assert files[0].name == "index.html"
    assert "†1" in printed(folder)
    assert any("figure images" in message for message in said)
    assert not list((folder / "report").glob("figures/*"))
    assert "all 3" in (folder / "report" / "status.md").read_text("utf-8")
