"""Running: what is stored stays, what fails says why, what is missing is done."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from harness import load_results
from harness.core.protocol.errors import InputError
from harness.runner import run as running
from harness.runner.progress import Pace, duration
from harness.runner.run import Options, run
from harness.store.damage import damage as damage_of
from harness.store.folder import ResultsFolder
from harness.store.stored import STATE, Stored
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests import fakes
from tests.fakes import Clock, Probe

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def go(folder: Path, options: Options = Options(), **changes: Any) -> tuple[int, str]:  # noqa: B008
    """Run a suite of fakes in ``folder``; results in ``folder/out``."""
    plan = make_plan(load(fakes.suite(folder, **changes)))
    text = io.StringIO()
    status = run(plan, folder / "out", options, Console(file=text, width=200, highlight=False))
    return status, text.getvalue()


def rows(folder: Path, **labels: str) -> Any:
    frame = load_results(folder / "out")
    for key, value in labels.items():
        frame = frame[frame[key] == value]
    return frame


def trial_of(folder: Path, key: str) -> Stored:
    with ResultsFolder(folder / "out") as store:
        return store.trial(key)


def whole(folder: Path) -> dict[str, Stored]:
    """All stored trials; none of them is damaged."""
    with ResultsFolder(folder / "out") as store:
        assert damage_of(store) == {}
        return store.trials()


def forget(folder: Path, key: str) -> None:
    """Take a trial out of the store."""
    with ResultsFolder(folder / "out", write=True) as store:
        store.set_aside({key: "for a test"})


def adapters(*names: str) -> list[str]:
    return ["adapters.py:Good", *(f"adapters.py:{name}" for name in names)]


def test_first_and_second_run(tmp_path: Path):
    status, text = go(tmp_path)
    assert status == 0
    assert "12 trials: 12 ok" in text
    frame = load_results(tmp_path / "out")
    assert set(frame["status"]) == {"ok"}
    assert len(frame["trial"].unique()) == 12
    before = whole(tmp_path)
    calls = len(Probe.calls), len(Clock.calls)
    status, text = go(tmp_path)
    assert status == 0
    assert "12 trials, all stored" in text
    assert (len(Probe.calls), len(Clock.calls)) == calls
    assert str(whole(tmp_path)) == str(before)


def test_what_is_stored_of_a_trial(tmp_path: Path):
    go(tmp_path)
    found = trial_of(
        tmp_path, rows(tmp_path, measure="probe", method="with-state").iloc[0]["trial"]
    )
    assert (set(found.arrays), set(found.images)) == ({"weights"}, {"flat"})
    assert found.documents == {"note": "kept"}
    assert found.environment["machine"]["cores"] >= 1
    assert found.environment["versions"]["torch"]
    assert found.started < "3000"
    assert found.labels["material"] == "fake-a"
    assert {"adapter", "material", "measure", "fit", "versions"} <= set(found.parts)
    fit = trial_of(tmp_path, found.fit)
    assert fit.has_state and "training" in fit.parts
    assert found.parts["fit"] == fit.files[STATE]
    text = (tmp_path / "out" / "suite.yaml").read_text()
    assert load(tmp_path / "suite.yaml").text in text
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "results.sqlite", "files", "suite.yaml", ".lock"
    }  # fmt: skip
    assert str(tmp_path) not in str(vars(replace(found, folder=None, reader=None)))


def test_a_measure_gets_the_restored_state(tmp_path: Path):
    go(tmp_path)
    weight = rows(tmp_path, metric="weight", method="with-state", material="fake-a")["value"].item()
    fit = rows(tmp_path, measure="fit", method="with-state", material="fake-a")
    state = trial_of(tmp_path, fit["trial"].iloc[0]).tensors()
    assert weight == pytest.approx(float(state["weights"].sum()))
    assert fit.set_index("metric").loc["parameters", "value"] == 3
    assert fit.set_index("metric").loc["final-loss", "value"] == 1
    # In another process, from the store alone, it is the same.
    forget(tmp_path, rows(tmp_path, metric="weight", method="with-state").iloc[0]["trial"])
    go(tmp_path)
    assert rows(tmp_path, metric="weight", method="with-state", material="fake-a")[
        "value"
    ].item() == pytest.approx(weight)


@pytest.mark.parametrize(
    ("name", "status", "reason"),
    [
        ("Raises", "error", "RuntimeError: no luck"),
        ("WrongShape", "error", "WrongShape: pdf has shape [64, 1], expected [64]"),
        ("Nan", "error", "Nan: pdf is not finite in 64 of 64 rows"),
        ("NotSample", "error", "NotSample: sample returned a tensor of shape [64, 2], expected a"),
        ("Slow", "timeout", "took 2 s of 1 s"),
    ],
)
def test_a_bad_adapter_fails_alone(tmp_path: Path, name: str, status: str, reason: str):
    code, text = go(tmp_path, methods=adapters(name), materials=["fake-a"])
    assert code == 1
    assert reason in text
    fit = rows(tmp_path, method=name, measure="fit")
    assert fit["status"].item() == status
    assert fit["reason"].item().startswith(reason)
    for measure in ("probe", "clock"):
        row = rows(tmp_path, method=name, measure=measure)
        assert row["status"].item() == "skipped"
        assert row["reason"].item().startswith(f"the fit of {name} ended as {status}: {reason}")
    assert set(rows(tmp_path, method="Good")["status"]) == {"ok"}
    trial = trial_of(tmp_path, fit["trial"].item())
    assert "Traceback" in trial.traceback
    # Nothing more to do, and still a failure.
    code, text = go(tmp_path, methods=adapters(name), materials=["fake-a"])
    assert code == 1
    assert "all stored" in text


def test_unsupported_is_no_failure(tmp_path: Path):
    code, _ = go(tmp_path, methods=adapters("Choosy"), materials=["fake-a"])
    assert code == 0
    found = rows(tmp_path, method="Choosy")
    assert set(found["status"]) == {"unsupported"}
    assert set(found["reason"]) == {"wants features"}
    _, text = go(tmp_path, methods=adapters("Choosy"), materials=["fake-a"])
    assert "all stored" in text


def test_nan_is_nonfinite(tmp_path: Path):
    measures = [{"name": "probe", "poison": True}]
    code, _ = go(tmp_path, measures=measures, scenes=None)
    assert code == 1
    bad = rows(tmp_path, metric="mean-pdf")
    assert set(bad["status"]) == {"nonfinite"}
    assert set(bad["reason"]) == {"mean-pdf is nan"}
    assert set(rows(tmp_path, metric="weight")["status"]) == {"ok"}


def test_retry_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    flag = tmp_path / "flag"
    monkeypatch.setenv("FAKE_FLAG", str(flag))
    flag.write_text("")
    changes = {"methods": adapters("FailsOnce"), "materials": ["fake-a"]}
    assert go(tmp_path, **changes)[0] == 1
    flag.unlink()
    assert go(tmp_path, **changes)[0] == 1, "failed trials are not run again unasked"
    ran = len(Probe.calls)
    assert go(tmp_path, Options(retry_failed=True), **changes)[0] == 0
    assert set(load_results(tmp_path / "out")["status"]) == {"ok"}
    assert Probe.calls[ran:] == ["FailsOnce"], "only what had failed or was skipped"


def test_timed_measures_run_together_with_the_baseline(tmp_path: Path):
    go(tmp_path, materials=["fake-a"])
    assert Clock.calls == [["Good", "with-state"]]
    stored = rows(tmp_path, method="Good", measure="clock")["trial"].item()
    before = trial_of(tmp_path, stored)
    # A method that comes later: the baseline runs along, and its own result stays.
    go(tmp_path, materials=["fake-a"], methods=adapters("Named", "Choosy", "BadInRender"))
    assert Clock.calls[1][:2] == ["Good", "BadInRender"]
    assert str(trial_of(tmp_path, stored)) == str(before)


def test_one_bad_method_does_not_spoil_a_timed_group(tmp_path: Path):
    code, _ = go(tmp_path, materials=["fake-a"], methods=adapters("BadInRender", "Named"))
    assert code == 1
    assert Clock.calls == [
        ["Good", "BadInRender", "with-state"],
        ["Good"],
        ["Good", "BadInRender"],
        ["Good", "with-state"],
    ]
    found = rows(tmp_path, measure="clock").set_index("method")
    assert found["status"].to_dict() == {"Good": "ok", "BadInRender": "error", "with-state": "ok"}
    assert found.loc["BadInRender", "reason"] == "RuntimeError: broke in the render"


def test_without_a_baseline_nothing_is_timed(tmp_path: Path):
    methods = ["adapters.py:Raises", "adapters.py:Named"]
    code, _ = go(tmp_path, materials=["fake-a"], methods=methods, baseline="Raises")
    assert code == 1
    row = rows(tmp_path, method="with-state", measure="clock")
    assert row["status"].item() == "skipped"
    assert "the fit of the baseline Raises ended as error" in row["reason"].item()
    assert Clock.calls == []
    assert "all stored" in go(
        tmp_path, materials=["fake-a"], methods=methods, baseline="Raises"
    )[1]  # fmt: skip


def test_only_a_part_keeps_the_rest_planned(tmp_path: Path):
    code, text = go(tmp_path, Options(only="material=fake-b,method=with-state"))
    assert code == 0
    assert "3 trials, 4 to do (2 of them fits)" in text, "timing needs the baseline's fit too"
    frame = load_results(tmp_path / "out")
    assert len(frame["trial"].unique()) == 12
    done = frame[frame["status"] == "ok"]
    assert set(done["material"]) == {"fake-b"}
    assert set(frame[frame["status"] == "skipped"]["reason"]) == {"not run yet"}
    go(tmp_path, Options(only="measure=probe"))
    assert set(rows(tmp_path, measure="probe")["status"]) == {"ok"}
    assert set(rows(tmp_path, measure="clock", material="fake-a")["status"]) == {"skipped"}
    go(tmp_path)
    assert set(load_results(tmp_path / "out")["status"]) == {"ok"}


def test_only_takes_several_names_of_a_key(tmp_path: Path):
    text = go(tmp_path, Options(only="method=Good,with-state,material=fake-b", dry_run=True))[1]
    assert "probe · Good · fake-b" in text and "probe · with-state · fake-b" in text
    assert "fake-a" not in text
    again = go(tmp_path, Options(only="material=fake-b", dry_run=True))[1]
    assert again == text, "there are no other methods"


def test_only_takes_labels_with_an_equals_sign(tmp_path: Path):
    named = {"name": "adapters.py:Named", "label": "named (k=1)"}
    only = Options(only="method=Good,named (k=1),material=fake-b", dry_run=True)
    text = go(tmp_path, only, methods=["adapters.py:Good", named])[1]
    assert "probe · Good · fake-b" in text and "probe · named (k=1) · fake-b" in text


@pytest.mark.parametrize(
    ("only", "message"),
    [
        ("material=fake-c", "no material 'fake-c' in .*suite.yaml; did you mean"),
        ("methd=Good", "expected KEY=NAME, .*; did you mean 'method'"),
        ("Good", "expected KEY=NAME"),
        ("method=Good,fake-b", "no method 'fake-b' in"),
        ("measure=prob", "no measure 'prob' .*; did you mean 'probe'"),
    ],
)
def test_only_refuses_unknown_names(tmp_path: Path, only: str, message: str):
    with pytest.raises(InputError, match=message):
        go(tmp_path, Options(only=only))
    assert not (tmp_path / "out").exists()


def test_dry_run_touches_nothing(tmp_path: Path):
    code, text = go(tmp_path, Options(dry_run=True))
    assert code == 0
    assert "12 trials, 12 to do (4 of them fits)" in text
    assert "probe · Good · fake-a · seed 0" in text
    assert not (tmp_path / "out").exists()


def test_unknown_executor(tmp_path: Path):
    with pytest.raises(InputError, match="unknown executor 'locl'; did you mean 'local'"):
        go(tmp_path, Options(executor="locl"))


def test_refused_before_anything_runs(tmp_path: Path):
    bad = {"name": "adapters.py:Named", "params": {"scael": 1}}
    with pytest.raises(InputError, match="methods: 'with-state .*unknown parameter 'scael'"):
        go(tmp_path, methods=["adapters.py:Good", bad])
    with pytest.raises(InputError, match="report.tables.0.: unknown table 'tabel2'; did you mean"):
        go(tmp_path, report={"tables": ["tabel2"]})
    assert whole(tmp_path) == {}


def test_output_must_be_a_folder(tmp_path: Path):
    (tmp_path / "out").write_text("")
    with pytest.raises(InputError, match="is a file"):
        go(tmp_path)


def test_a_lost_state_is_fitted_again(tmp_path: Path):
    go(tmp_path, measures=["probe"], scenes=None)
    fit = rows(tmp_path, measure="fit", method="with-state", material="fake-a")["trial"].iloc[0]
    before = trial_of(tmp_path, fit)
    state, calls = before.tensors(), list(Probe.calls)
    (tmp_path / "out" / "files" / f"{before.files[STATE]}.safetensors").unlink()
    code, text = go(tmp_path, measures=["probe"], scenes=None)
    assert code == 0 and "is missing" in text and "2 of them fits" in text, "both kept one file"
    after = trial_of(tmp_path, fit)
    assert after.files == before.files and after.started >= before.started
    assert after.tensors()["weights"].equal(state["weights"])
    assert Probe.calls == calls, "measured with the same state, which came back"


def test_two_labels_share_a_trial(tmp_path: Path):
    twice = [{"name": "adapters.py:Good", "label": x} for x in ("one", "two")]
    assert go(tmp_path, methods=twice, baseline="one", measures=["probe"], scenes=None)[0] == 0
    frame = load_results(tmp_path / "out")
    assert len(frame["trial"].unique()) == 4
    assert len(frame[frame["method"] == "one"]) == len(frame[frame["method"] == "two"])


@pytest.mark.parametrize("baseline", ["one", "two"])
def test_a_second_label_of_the_baseline_is_timed_as_the_baseline(tmp_path: Path, baseline: str):
    twice = [{"name": "adapters.py:Good", "label": x} for x in ("one", "two")]
    methods = [*twice, "adapters.py:Named"]
    assert go(tmp_path, materials=["fake-a"], methods=methods, baseline=baseline)[0] == 0
    assert Clock.calls == [[baseline, "with-state"]]
    assert set(rows(tmp_path, measure="clock")["method"]) == {"one", "two", "with-state"}


def test_interrupt_stores_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    original, calls = Probe.run, []

    def interrupted(self: Probe, jobs: Any, notify: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(self, jobs, notify)

    monkeypatch.setattr(Probe, "run", interrupted)
    code, text = go(tmp_path)
    assert code == running.INTERRUPTED
    assert "interrupted after 3 of 12 trials" in text
    assert "the same command goes on" in text
    assert len(whole(tmp_path)) == 3
    code, text = go(tmp_path)
    assert code == 0
    assert "9 to do" in text


def test_kill_leaves_no_partial_trial(tmp_path: Path):
    flag = tmp_path / "flag"
    changes = {"methods": adapters("Endless"), "materials": ["fake-a"]}
    path = fakes.suite(tmp_path, **changes)
    environment = os.environ | {"FAKE_FLAG": str(flag), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.fakes", "run", str(path), "--out", f"{tmp_path}/out"]
    process = subprocess.Popen(command, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not flag.exists() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.05)
    with pytest.raises(InputError, match="another run is writing there"):
        go(tmp_path, **changes)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(whole(tmp_path)) == 1, "what was finished is stored"
    frame = load_results(tmp_path / "out")
    assert set(frame["status"]) == {"ok", "skipped"}
    go(tmp_path, Options(only="method=Good"), **changes)
    assert set(rows(tmp_path, method="Good")["status"]) == {"ok"}


def test_time_left(tmp_path: Path):
    plan = make_plan(load(fakes.suite(tmp_path)))
    pace = Pace(plan.trials, {})
    assert str(pace) == ""
    fits = [t for t in plan.trials if t.measure == "fit"]
    pace.finish(fits[0], 10.0)
    count = sum(t.measure == "fit" for t in plan.trials) - 1
    assert str(pace) == f"more than {duration(10.0 * count)} left"  # of other measures, who knows
    for trial in (t for t in plan.trials if t.measure != "fit"):
        pace.finish(trial, 20.0 if trial.method == plan.baseline else 1.0)
    # Fits of another method may take any time, as far as is known.
    assert str(pace) == f"more than {duration(10.0 * count)} left"
    slow = Pace(plan.trials, {}, clock=iter([0.0, *[60.0] * 9]).__next__)
    for trial in fits:
        slow.finish(trial, 5.0)
    for trial in [t for t in plan.trials if t.measure == "probe"][:2]:
        slow.finish(trial, 5.0)
    # Two probes are left; thirty seconds of work took a minute.
    assert slow.seconds() == pytest.approx(2 * 5.0 * 60 / 30)
    beside = Pace(plan.trials, {}, slots=2)
    beside.finish(fits[0], 10.0)
    assert beside.seconds() == pytest.approx(10.0 * count / 2)
    again = Pace([t for t in plan.trials if t.measure != "fit"], {})
    again.spent = pace.spent
    left = sum(20.0 if t.method == plan.baseline else 1.0 for t in plan.trials if t.fit)
    assert str(again) == f"about {duration(left)} left"  # of each method what it took
    # Known from elsewhere, to be twice as slow here as the one that was seen.
    there = {("fit", t.method): 100.0 if t.method == fits[-1].method else 5.0 for t in fits}
    known = Pace(fits, {}, elsewhere=there)
    assert str(known) == f"about {duration(sum(there['fit', t.method] for t in fits))} left"
    known.finish(fits[0], 10.0)
    rest = sum(2 * there["fit", t.method] for t in fits[1:])
    assert str(known) == f"about {duration(rest)} left"
    assert (duration(0.2), duration(89), duration(91), duration(12000)) == (
        "1 s", "89 s", "2 min", "3 h 20 min"
    )  # fmt: skip
