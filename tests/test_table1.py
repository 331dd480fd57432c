"""The table of where the time goes, from made-up trials of ``cost``."""

from __future__ import annotations

import pytest

from harness.analysis.results import Results
from harness.report.parts import part
from harness.report.published.neusample import neusample
from harness.report.table import Cell, Table
from tests.report_results import METHODS, Made

SHOWN = ["cosine", "improved-baseline", "two-lobe", "realnvp", "native"]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Table:
    asked = {"tables": ["table1"], "figures": None}
    made = Made(measures=("cost",), methods=SHOWN, report=asked)
    folder = made.write(tmp_path_factory.mktemp("table1"))
    table = part("tables", "table1")(Results.load(folder))
    assert isinstance(table, Table), table
    return table


def cell(table: Table, method: str, column: str) -> Cell:
    (row,) = [r for section in table.sections for r in section.rows if r.label == method]
    return row.cells[table.columns.index(column)]


def test_the_caption_says_how_often_it_was_taken(table: Table) -> None:
    assert "80 to 96 interleaved rounds in 10 to 12 processes, geometric means" in table.caption


def test_numbers_are_what_is_recorded(table: Table) -> None:
    nanoseconds = METHODS["cosine"][2]
    found = cell(table, "cosine", "rendering ms/spp")
    assert found.value == pytest.approx(nanoseconds * 1e-6 * 32**2)
    assert cell(table, "cosine", "sampling %").value == pytest.approx(100 * (1 - 80 / nanoseconds))
    assert cell(table, "cosine", "compile").missing  # nothing says what it took


def test_a_disturbed_timing_is_marked(table: Table) -> None:
    assert "disturbed: cost" in cell(table, "two-lobe", "rendering ms/spp").warning
    assert not cell(table, "cosine", "rendering ms/spp").warning


def test_a_suite_of_ones_own_gets_no_papers_figures(tmp_path) -> None:
    """Which one that names the table does."""
    folder = Made(measures=("cost", "equal-time"), methods=SHOWN).write(tmp_path)
    results = Results.load(folder)
    for name in ("table1", "table2"):
        made = part("tables", name)(results)
        assert isinstance(made, Table) and neusample().short not in str(made), name


def test_the_paper_has_columns_of_its_own(table: Table) -> None:
    paper = neusample()
    column = f"{paper.short}: rendering {paper.table1['unit']}"
    assert cell(table, "two-lobe", column).value == paper.table1["rendering"]["two-lobe"]
    assert cell(table, "native", column).missing
