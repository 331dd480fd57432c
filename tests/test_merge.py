"""Results of one suite from several folders in one."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from harness import load_results
from harness.cli.main import main
from harness.core import machine
from harness.core.protocol.errors import InputError
from harness.report import write as reports
from harness.runner.run import Options, run
from harness.store.damage import damage
from harness.store.folder import ResultsFolder
from harness.store.merge import merge
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests import fakes


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def go(folder: Path, out: str, only: str | None = None, **changes: Any) -> Path:
    """Results of the suite of fakes, or of a part of it."""
    plan = make_plan(load(fakes.suite(folder, **changes)))
    run(plan, folder / out, Options(only=only), Console(file=io.StringIO()))
    return folder / out


def test_parts_of_a_suite_are_the_whole(tmp_path: Path) -> None:
    whole = load_results(go(tmp_path, "whole"))
    parts = [go(tmp_path, name, f"material={name}") for name in ("fake-a", "fake-b")]
    merged = merge(parts, tmp_path / "out")
    assert merged.taken == {parts[0]: 6, parts[1]: 6}
    assert not merged.conflicts and not merged.elsewhere
    found = load_results(tmp_path / "out")
    numbers = ["material", "method", "measure", "metric", "status"]
    assert found[numbers].equals(whole[numbers])
    with ResultsFolder(tmp_path / "out") as store:
        assert damage(store) == {}
        fits = [t for t in store.trials().values() if t.labels["method"] == "with-state"]
        assert fits[0].arrays is not None and any(t.has_state for t in fits)
    # And goes on as if it had run here.
    plan = make_plan(load(tmp_path / "suite.yaml"))
    said = io.StringIO()
    assert run(plan, tmp_path / "out", Options(), Console(file=said, width=200)) == 0
    assert "all stored" in said.getvalue()


def test_times_of_another_machine_are_kept_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first = go(tmp_path, "first")
    monkeypatch.setattr(machine, "identity", lambda device="cpu": {"cpu": "Other", "cores": 64})
    second = go(tmp_path, "second")
    out = tmp_path / "out"
    assert main(["merge", str(first), str(second), "--out", str(out)]) == 0
    assert "8 of another machine, kept apart: Other, 64 cores" in capsys.readouterr().out
    found = load_results(out)
    clock = found[found["measure"] == "clock"]
    assert sorted(clock["method"].unique()) == [
        "Good", "Good [Other, 64 cores]", "with-state", "with-state [Other, 64 cores]"
    ]  # fmt: skip
    assert not clock.duplicated(["material", "method", "scene", "metric"]).any()
    probe = found[(found["measure"] == "probe") & (found["metric"] == "weight")]
    assert sorted(probe["method"].unique()) == ["Good", "with-state"], "no times: the same trial"
    reports.load(out).write()


def test_the_better_status_is_taken_and_conflicts_are_said(tmp_path: Path) -> None:
    first, second = go(tmp_path, "first"), go(tmp_path, "second")
    with ResultsFolder(first, write=True) as store:
        trials = [t for t in store.trials().values() if t.labels["measure"] == "probe"]
        failed = replace(trials[0], status="error", reason="no luck", records=[])
        other = replace(trials[1], records=[{**r, "value": 7.0} for r in trials[1].records])
        store.save_records({failed.hash: failed, other.hash: other})
    merged = merge([first, second], tmp_path / "out")
    assert merged.conflicts == {second: [other.hash]}
    with ResultsFolder(tmp_path / "out") as store:
        found = store.trials()
    assert found[failed.hash].status == "ok"
    assert {r["value"] for r in found[other.hash].records} == {7.0}


def test_what_is_refused(tmp_path: Path) -> None:
    first = go(tmp_path, "first", "material=fake-a")
    other = go(tmp_path, "other", "material=fake-a", name="others")
    with pytest.raises(InputError, match="suite is 'others', in .*first it is 'fakes'"):
        merge([first, other], tmp_path / "out")
    with pytest.raises(InputError, match="holds results already"):
        merge([first, first], other)
    assert main(["merge", str(first), "--out", str(tmp_path / "out")]) == 2
    assert main(["merge", str(first), "nowhere", "--out", str(tmp_path / "out")]) == 2
