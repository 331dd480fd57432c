"""A table or a figure is one file: found by its name, without a list and without imports."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from harness.analysis.results import Results
from harness.report import write as reports
from harness.report.parts import KINDS, names, parts
from harness.runner.preflight import check_report
from harness.suite.plan import Plan
from tests.report_reading import page_data
from tests.report_results import Made

TABLE = '''
"""A table of one cell."""
from harness.report.table import Cell, Row, Section, Table

ORDER = 25


def how_many(results):
    """How many materials there are."""
    cell = Cell(float(len(results.materials)))
    return Table("how-many", "How many", "", "", ["materials"], [Section("", [Row("", [cell])])])


def helper():
    """No table: the file is not called after it."""
'''
FIGURE = '''
from matplotlib.figure import Figure


def blank(results, canvas):
    """Nothing, drawn."""
    figure = Figure(figsize=(1, 1))
    return [canvas.save(figure, "blank", "Blank", "Nothing.")]
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One file more in each folder of parts."""
    for kind, name, text in (("tables", "how_many", TABLE), ("figures", "blank", FIGURE)):
        package = import_module(f"harness.report.{kind}")
        folder = tmp_path / kind
        folder.mkdir()
        (folder / f"{name}.py").write_text(text)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
        monkeypatch.delitem(sys.modules, f"{package.__name__}.{name}", raising=False)


@pytest.mark.usefixtures("added")
def test_one_file_adds_a_table_or_a_figure(tmp_path: Path):
    tables = names("tables")
    assert tables.index("how-many") == tables.index("table2") + 1  # ORDER 25, after 20
    assert "helper" not in tables
    assert names("figures")[-1] == "blank"  # without ORDER: last
    assert parts("tables")["how-many"].summary == "How many materials there are."

    made = Made(materials=["suede", "brocade"], measures=("fit",))
    folder = made.write(tmp_path / "results")
    results = Results.load(folder)
    results.plan["report"] = {"tables": ["how-many"], "figures": ["blank"]}
    tables, _ = reports._tables(results)
    written = {path.name for path in reports.Report(results, tables, []).write()}
    assert {"how-many.md", "blank.png"} <= written
    page = page_data((folder / "report" / "index.html").read_text("utf-8"))
    assert "How many" in page["tables"][0]["title"]
    assert "blank.png" in page["figures"][0]["files"]


@pytest.mark.usefixtures("added")
def test_a_suite_may_name_what_a_file_adds():
    plan = Plan.__new__(Plan)
    object.__setattr__(plan, "report", {"tables": ["how-many"], "figures": ["blank"]})
    object.__setattr__(plan, "where", "a suite")
    check_report(plan)


@pytest.mark.parametrize("kind", KINDS)
def test_every_part_has_its_own_place_and_a_summary(kind: str):
    found = list(parts(kind).values())
    assert len({part.order for part in found}) == len(found)
    for part in found:
        assert part.summary, part.name
        assert part.load().__name__ == part.name.replace("-", "_")


def test_names_are_listed_without_importing_what_draws():
    code = (
        "import sys; from harness.report.parts import KINDS, names;"
        "assert all(names(kind) for kind in KINDS);"
        "heavy = {'matplotlib', 'pandas', 'torch', 'mitsuba'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
