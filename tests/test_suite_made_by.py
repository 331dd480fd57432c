"""Materials of a suite that a command makes first: left out, a line each, until they are there."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from harness.analysis.results import Results
from harness.core.protocol.errors import InputError
from harness.report.parts import part
from harness.report.table import Table
from harness.runner.run import Options, run
from harness.suite.load import find, load
from harness.suite.plan import make_plan
from tests import fakes

ENTRY = {"name": "fake-c", "file": "made/c.safetensors", "made_by": "harness material train c"}
MATERIALS = ["fake-a", ENTRY]


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def test_a_material_comes_in_when_its_file_is_there(tmp_path: Path):
    suite = fakes.suite(tmp_path, materials=MATERIALS)
    before = load(suite)
    assert [m.name for m in before.suite.materials] == ["fake-a"]
    assert before.left_out == {"fake-c": "harness material train c"}
    made = suite.parent / "made" / "c.safetensors"
    made.parent.mkdir()
    made.touch()
    after = load(suite)
    assert not after.left_out
    assert [m.name for m in after.suite.materials] == ["fake-a", "fake-c"]
    assert after.suite.materials[1].rest() == {"file": str(made)}


def test_measures_and_profiles_may_name_it(tmp_path: Path):
    changes: dict[str, Any] = {
        "materials": MATERIALS,
        "measures": [{"name": "probe", "materials": ["fake-c"]}, {"name": "clock"}],
        "profiles": {"both": {"materials": ["fake-a", "fake-c"]}, "one": {"materials": ["fake-c"]}},
    }
    loaded = load(fakes.suite(tmp_path, **changes))
    plan = make_plan(loaded, "both")
    assert plan.labels("material") == ["fake-a"]
    assert plan.labels("measure") == ["fit", "clock"]
    with pytest.raises(InputError, match=r"profiles\.one\.materials: none of them is made yet"):
        make_plan(loaded, "one")


def test_run_and_report_say_what_makes_it(tmp_path: Path):
    plan = make_plan(load(fakes.suite(tmp_path, materials=MATERIALS)))
    text = io.StringIO()
    assert (
        run(plan, tmp_path / "out", Options(executor="inline"), Console(file=text, width=200)) == 0
    )
    said = "not made yet: harness material train c"
    assert f"'fake-c' is left out, {said}" in text.getvalue()
    table = part("tables", "status")(Results.load(tmp_path / "out"))
    assert isinstance(table, Table)
    rows = [row for section in table.sections for row in section.rows]
    assert [row.label for row in rows] == ["fake-c"]
    assert [cell.text for cell in rows[0].cells] == [" ", " ", "left out", said]


@pytest.mark.parametrize(
    ("materials", "said"),
    [
        ([ENTRY], "materials: none is there: 'fake-c'"),
        (["fake-a", {**ENTRY, "made_by": 3}], r"materials\[1\]: made_by: expected a text, got 3"),
        (
            ["fake-a", {"name": "x", "made_by": "a"}],
            r"materials\[1\]: file: expected a text beside",
        ),
        (
            ["fake-a", {"file": "x", "made_by": "a"}],
            r"materials\[1\]: name: expected a text beside",
        ),
    ],
)
def test_refused(tmp_path: Path, materials: list, said: str):
    with pytest.raises(InputError, match=said):
        load(fakes.suite(tmp_path, materials=materials))


def test_a_folder_does_not_hide_a_suite_of_its_name(tmp_path: Path, monkeypatch):
    (tmp_path / "puresample").mkdir()
    monkeypatch.chdir(tmp_path)
    assert find("puresample").name == "puresample.yaml"
    (tmp_path / "mine").mkdir()
    with pytest.raises(InputError, match="mine: is a directory"):
        find("mine")
