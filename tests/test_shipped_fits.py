"""Fitted samplers that come with the harness: a run takes them, and says so."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from harness import load_results
from harness.analysis.results import Results
from harness.analysis.status import counted
from harness.analysis.validity import Changed, changed, said_of_earlier
from harness.core.protocol.errors import InputError
from harness.runner import known_seconds, shipped
from harness.runner.run import Options, run
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored
from harness.suite.load import load
from harness.suite.plan import make_plan
from harness.suite.trials import FIT
from tests import fakes
from tests.report_results import Made


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    fakes.install(monkeypatch.setattr)
    monkeypatch.setattr(shipped, "FOLDER", tmp_path / "fitted")
    monkeypatch.setattr(shipped.find, "__defaults__", (tmp_path / "fitted",))
    return tmp_path / "fitted"


def plan_of(where: Path, **changes: Any):
    return make_plan(load(fakes.suite(where, **changes)))


def trial_of(folder: Path, key: str) -> Stored:
    with ResultsFolder(folder) as store:
        return store.trial(key)


def go(where: Path, out: str, options: Options = Options(), **changes: Any):  # noqa: B008
    """Results of a run by hash of the fit with a state, and the plan."""
    plan = plan_of(where, **changes)
    console = Console(file=io.StringIO(), width=200)
    assert run(plan, where / out, options, console) == 0
    fits = [t for t in plan.trials if t.measure == FIT and t.method == "with-state"]
    return {t.material: trial_of(where / out, t.hash) for t in fits}, plan


def keep(where: Path, out: str, plan: Any, folder: Path) -> list[Path]:
    """What ``harness fit`` does with the results of a run."""
    written = [
        shipped.save(t, trial_of(where / out, t.hash), folder)
        for t in plan.trials
        if t.measure == FIT
    ]
    return [path for path in written if path]


def same(a: Stored, b: Stored) -> bool:
    return all((a.tensors()[k] == v).all() for k, v in b.tensors().items())


def numbers(fit: Stored) -> dict[str, float]:
    return {record["metric"]: record["value"] for record in fit.records}


def test_a_run_takes_the_stored_fit_with_its_record(tmp_path: Path, folder: Path):
    first, plan = go(tmp_path, "one")
    assert len(keep(tmp_path, "one", plan, folder)) == len(first)
    second, _ = go(tmp_path, "two")
    for material, fit in first.items():
        found = second[material]
        assert found.shipped.startswith(f"{material}--with-state--") and not fit.shipped
        assert same(found, fit) and numbers(found) == numbers(fit)
        assert found.environment == fit.environment and found.started == fit.started
        assert found.seconds == fit.seconds
        assert (found.arrays["loss"] == fit.arrays["loss"]).all()
    # Measured with the same state, it is the same number.
    weights = [
        load_results(tmp_path / out).query("metric == 'weight'")["value"].tolist()
        for out in ("one", "two")
    ]
    assert weights[0] == weights[1]


def test_how_long_kept_fits_took_is_known(tmp_path: Path, folder: Path):
    """Of a method by its label, whatever the material, seed or budget was."""
    first, plan = go(tmp_path, "one")
    keep(tmp_path, "one", plan, folder)
    took = [fit.seconds for fit in first.values()]
    assert sorted(shipped.seconds("with-state", folder)) == sorted(took)
    assert shipped.seconds("state", folder) == []
    with ResultsFolder(tmp_path / "one") as store:
        known = known_seconds.of([], store.trials())
    assert known[FIT, "with-state"] == pytest.approx(sum(took) / len(took))
    assert {measure for measure, _ in known} == {*plan.labels("measure")}


def test_a_fit_of_anything_else_is_run(tmp_path: Path, folder: Path):
    _, plan = go(tmp_path, "one")
    keep(tmp_path, "one", plan, folder)
    other, _ = go(tmp_path, "two", budget={"steps": 7})
    assert not any(fit.shipped for fit in other.values())


def test_refit_fits_and_measures_anew(tmp_path: Path, folder: Path):
    _, plan = go(tmp_path, "one")
    keep(tmp_path, "one", plan, folder)
    before, _ = go(tmp_path, "two")
    after, _ = go(tmp_path, "two", Options(refit=True))
    assert all(fit.shipped for fit in before.values())
    assert not any(fit.shipped for fit in after.values())
    probes = [t for t in plan.trials if t.measure == "probe" and t.method == "with-state"]
    for trial in probes:
        started = trial_of(tmp_path / "two", trial.hash).started
        assert started >= after[trial.material].started
    # Once more, there is nothing left to do anew.
    again, _ = go(tmp_path, "two", Options(refit=True))
    assert [f.started for f in again.values()] == [f.started for f in after.values()]


def test_a_fit_without_state_is_not_kept(tmp_path: Path, folder: Path):
    _, plan = go(tmp_path, "one")
    names = {path.name.split("--")[1] for path in keep(tmp_path, "one", plan, folder)}
    assert names == {"with-state"}


def test_the_key_holds_neither_machine_nor_versions_nor_device(tmp_path: Path):
    _, plan = go(tmp_path, "one")
    trial = next(t for t in plan.trials if t.measure == FIT and t.method == "with-state")
    text = str(shipped.described(trial))
    assert "machine" not in text and "versions" not in text and "device" not in text


def test_a_damaged_file_is_refused_with_the_way_out(tmp_path: Path, folder: Path):
    _, plan = go(tmp_path, "one")
    path = keep(tmp_path, "one", plan, folder)[0]
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(InputError, match="not a fitted sampler.*--refit"):
        shipped.load(path)


def test_a_fit_by_an_earlier_version_of_the_code_is_data(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    _, plan = go(tmp_path, "one")
    keep(tmp_path, "one", plan, folder)
    load_it = shipped.load

    def by_other_code(path: Path) -> Any:
        outcome, about = load_it(path)
        return outcome, about | {"parts": dict.fromkeys(about["parts"], "0")}

    monkeypatch.setattr(shipped, "load", by_other_code)
    before, _ = go(tmp_path, "two")
    after, _ = go(tmp_path, "two")
    assert all(fit.shipped and fit.parts["training"] == "0" for fit in before.values())
    assert [f.started for f in after.values()] == [f.started for f in before.values()]


def test_such_a_fit_is_no_stale_trial(tmp_path: Path):
    made = Made(materials=["suede"], methods=["cosine"], measures=("fit",)).write(tmp_path / "out")
    with ResultsFolder(made) as store:
        ((key, stored),) = store.trials().items()
        entries = {"measure": [["harness.measures.fit:Fit.run"], []]}
        mine = replace(stored, parts={"measure": "0"}, entries=entries)
        theirs = replace(mine, shipped="suede--cosine--0.safetensors")
        assert changed(store, {key: mine}).stale[key].startswith("stale: the measure changed")
        assert changed(store, {key: theirs}) == Changed({}, frozenset({key}))
    found = counted(made, replace(Results.load(made), earlier=frozenset({key})))
    assert found.all_valid and found.earlier == 1 and "stale" not in found.line()
    assert said_of_earlier(1) == (
        "1 fit shipped with the harness, fitted by an earlier version of the code: its seconds are "
        "those of that version"
    )
    assert said_of_earlier(0) == ""
