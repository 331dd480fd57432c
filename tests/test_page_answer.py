"""The page's first sentences, for a suite of which only a part was measured."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.report import write as reports
from harness.report.page.answer import answer
from harness.report.table import Cell, Row, Section, Table
from tests.report_results import MEASURES, Made

SCENES = ("uniform-sphere", "studio-sphere")


@pytest.mark.parametrize("missing", [(), ("uniform-sphere",), SCENES])
def test_scenes_without_a_number_are_left_out(tmp_path: Path, missing: tuple[str, ...]):
    """What was not measured in a scene leaves its section without rows."""
    folder = Made(not_run=MEASURES, scenes=SCENES).write(tmp_path / "results")
    results = reports.load(folder).results
    cells = [Cell(1.0), Cell(2.5, 2.0, 3.0)]
    sections = [
        Section(scene, [] if scene in missing else [Row("leather", cells)]) for scene in SCENES
    ]
    columns = ["improved-baseline", "two-lobe"]
    table = Table("table2", "Speed-up", "The caption.", "", columns, sections, best="high")
    said = answer(results, [table])["sentences"][0]
    if missing == SCENES:
        assert said == "Speed-up: The caption."
    else:
        assert said.startswith("Use two-lobe")
        assert ("uniform-sphere" in said) == ("uniform-sphere" not in missing)


@pytest.mark.parametrize("warning", ["", "mean over 8 of 12 materials only; without bulkhead"])
def test_means_of_fewer_materials_are_told_from_those_of_all(tmp_path: Path, warning: str):
    folder = Made(not_run=MEASURES, scenes=SCENES).write(tmp_path / "results")
    results = reports.load(folder).results
    assert len(results.materials) > 1
    cells = [Cell(1.0), Cell(2.5, 2.0, 3.0, warning=warning)]
    sections = [Section(scene, [Row("geometric mean", cells, summary=True)]) for scene in SCENES]
    columns = ["improved-baseline", "two-lobe"]
    table = Table("table2", "Speed-up", "The caption.", "", columns, sections, best="high")
    said = answer(results, [table])["sentences"][0]
    assert ("or those of them that are resolved" in said) is bool(warning)
