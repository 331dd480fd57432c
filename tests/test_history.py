"""Runs side by side: what moved, what cannot be compared and why; the pages by command."""

from __future__ import annotations

from pathlib import Path

import pytest

from harness.analysis.history import history
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from tests.report_reading import page_data
from tests.report_results import Made
from tests.test_compare import HERE, MONDAY, TUESDAY, write


@pytest.fixture
def runs(tmp_path: Path) -> list[Path]:
    return [
        write(tmp_path / "one", MONDAY, started="monday"),
        write(tmp_path / "two", TUESDAY, started="tuesday"),
    ]


def test_what_moved_and_what_cannot_be_said(runs: list[Path]):
    about, numbers = history(runs)
    found = {(one.key[1], one.metric): one for one in numbers}
    assert [run.first for run in about] == ["monday", "tuesday"]
    assert found["a", "time-ratio"].moved is True
    assert found["a", "time-ratio"].change == pytest.approx(2.3 / 2.0)
    assert found["b", "time-ratio"].moved is False  # ends that touch overlap
    assert found["base", "time-ratio"].why_not == "no interval"  # a definition
    assert found["c", "time-ratio"].why_not == "only the first run has it"
    assert found["a", "batch"].why_not == "no interval"


def test_the_first_is_compared_with_the_last_of_three(runs: list[Path], tmp_path: Path):
    back = write(tmp_path / "three", MONDAY, started="wednesday")
    _, numbers = history([*runs, back])
    one = next(n for n in numbers if n.key[1] == "a" and n.metric == "time-ratio")
    assert one.moved is False and [e.value for e in one.entries] == [2.0, 2.3, 2.0]


def test_another_machine_and_the_same_trial_are_reasons(runs: list[Path], tmp_path: Path):
    other = write(tmp_path / "x", TUESDAY, started="friday", machine=HERE | {"cores": 64})
    for folders, why in (
        ((runs[0], other), "times taken on different machines"),
        ((runs[0], runs[0]), "of one and the same measurement"),
    ):
        _, numbers = history(folders)
        assert next(n for n in numbers if n.metric == "time-ratio").why_not == why
    with pytest.raises(InputError, match="two results folders"):
        history(runs[:1])


def test_the_comparison_by_command(runs: list[Path], tmp_path: Path, capsys):
    out = tmp_path / "page.html"
    assert main(["compare", *map(str, runs), "--html", "--out", str(out)]) == 0
    data = page_data(out.read_text("utf-8"))
    assert [run["name"] for run in data["runs"]] == ["one", "two"]
    assert sum(bool(one[len(data["labels"]) + 3]) for one in data["numbers"]) == 1
    out.write_text("mine", encoding="utf-8")
    assert main(["compare", *map(str, runs), "--html", "--out", str(out)]) == 2
    assert out.read_text("utf-8") == "mine"
    assert main(["compare", *map(str, runs), str(runs[0])]) == 2
    assert "--html" in capsys.readouterr().err


def test_an_index_over_suites_by_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("first", "second"):
        Made(materials=["suede"], measures=("fit", "pdf"), size=8, title=name).write(
            tmp_path / name
        )
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert main(["report", str(tmp_path), "--open"]) == 0
    index = tmp_path / "index.html"
    assert opened == [index.resolve().as_uri()]
    suites = page_data(index.read_text("utf-8"))["suites"]
    assert [suite["title"] for suite in suites] == ["first", "second"]
    pages = [tmp_path / suite["page"] for suite in suites]
    assert all(page.is_file() for page in pages)
    before = [page.stat().st_mtime_ns for page in pages]
    assert main(["report", str(tmp_path)]) == 0  # pages as new as their results stay
    assert [page.stat().st_mtime_ns for page in pages] == before
