"""What a second run measures again: what changed a number, and nothing else; and what it says."""

from __future__ import annotations

import io
import json
import sqlite3
import zlib
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from harness import load_results
from harness.analysis import renew as renewing
from harness.analysis.results import Results
from harness.cli.main import main
from harness.core import machine
from harness.runner.run import Options, run
from harness.store.database import FILE
from harness.store.folder import ResultsFolder
from harness.store.stored import STATE
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests import fakes
from tests.fakes import Probe

pytestmark = pytest.mark.probes


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


SMALL: dict[str, Any] = {"materials": ["fake-a"], "measures": ["probe"], "scenes": None}


def go(folder: Path, again: bool = False, **changes: Any) -> tuple[list[str], str]:
    """Run a suite of fakes, written anew unless ``again``; which methods were probed, and what was
    said."""
    path = folder / "suite.yaml" if again else fakes.suite(folder, **SMALL | changes)
    text, before = io.StringIO(), len(Probe.calls)
    console = Console(file=text, width=400, highlight=False)
    assert run(make_plan(load(path)), folder / "out", Options(), console) == 0
    return Probe.calls[before:], text.getvalue()


def edit(folder: Path, old: str, new: str) -> None:
    file = folder / "adapters.py"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def test_a_number_in_an_adapter_that_changed_is_measured_again(tmp_path: Path):
    go(tmp_path)
    before = load_results(tmp_path / "out")
    edit(tmp_path, "torch.full((len(wo),), 1 / math.pi)", "torch.full((len(wo),), 1.001 / math.pi)")
    probed, said = go(tmp_path, again=True)
    assert probed == ["Good", "with-state"], "both inherit it"
    assert "4 trials, 4 to do (2 of them fits)" in said
    assert "stale: the method changed (" in said and "adapters.py: Good.pdf)" in said
    after = load_results(tmp_path / "out")
    assert list(after["trial"]) == list(before["trial"]), "it is the same question"
    is_pdf = after["metric"] == "mean-pdf"
    ratio = after[is_pdf]["value"].to_numpy() / before[is_pdf]["value"].to_numpy()
    assert ratio == pytest.approx(1.001, rel=1e-6)
    assert "all stored" in go(tmp_path, again=True)[1]


def test_what_changes_no_number_in_an_adapter_measures_nothing(tmp_path: Path):
    go(tmp_path)
    edit(tmp_path, '"""Uniform on the disk."""', '"""Uniform."""\n    # a remark\n')
    edit(tmp_path, "class NoMethod:", "def unused():\n    return 3\n\n\nclass NoMethod:")
    edit(tmp_path, "return torch.full((len(wo),)", "return torch.full(\n            (len(wo),)")
    probed, said = go(tmp_path, again=True)
    assert (probed, "4 trials, all stored" in said) == ([], True), said


def test_one_method_that_changed_leaves_the_others_alone(tmp_path: Path):
    go(tmp_path)
    edit(tmp_path, "* self.scale", "* self.scale * 2")
    probed, said = go(tmp_path, again=True)
    assert probed == ["with-state"]
    assert "adapters.py: Named.fit)" in said
    assert "1 to do (1 of them fits), 1 more if a fit comes out different" in said


def test_a_refit_that_gives_the_same_state_leaves_what_was_measured_with_it(tmp_path: Path):
    go(tmp_path)
    before = load_results(tmp_path / "out")
    edit(tmp_path, "loss=[2.0, 1.0]", "loss=[2.0, 1.5]")
    probed, said = go(tmp_path, again=True)
    assert probed == []
    assert "the method's training changed" in said and "Named.fit" in said
    after = load_results(tmp_path / "out")
    assert after.query("metric == 'final-loss' and method == 'with-state'")["value"].item() == 1.5
    same = before["measure"] == "probe"
    assert after[same].equals(before[same])


def test_a_file_that_params_name_counts_by_its_content(tmp_path: Path):
    given = tmp_path / "scale.json"
    adapter = "\n\nclass Filed(Good):\n    def __init__(self, file):\n        self.file = file\n"
    methods = ["adapters.py:Good", {"name": "adapters.py:Filed", "params": {"file": str(given)}}]
    given.write_text("1")

    def once() -> list[str]:
        path = fakes.suite(tmp_path, **SMALL | {"methods": methods})
        (tmp_path / "adapters.py").write_text(fakes.ADAPTERS + adapter)
        assert path.is_file()
        return go(tmp_path, again=True)[0]

    assert once() == ["Good", f"Filed (file={given})"]
    given.touch()
    assert once() == [], "the time of day is no content"
    given.write_text("1.001")
    frame = load_results(tmp_path / "out")
    stale = frame[frame["status"] == "stale"]
    assert set(stale["method"]) == {f"Filed (file={given})"}
    assert "scale.json" in stale["reason"].iloc[0]
    assert once() == [f"Filed (file={given})"]
    assert set(load_results(tmp_path / "out")["status"]) == {"ok"}
    given.write_text("1")
    assert once() == [], "what was measured with it is still there"


def test_what_is_damaged_is_measured_again_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    go(tmp_path, measures=["probe", "clock"], scenes=["fake-room"])
    out = tmp_path / "out"
    before = load_results(out)
    of = {(r["measure"], r["method"]): r["trial"] for r in before.to_dict("records")}
    probe, fit = of["probe", "Good"], of["fit", "with-state"]
    with closing(sqlite3.connect(out / FILE)) as store, store:
        ((body,),) = store.execute("SELECT body FROM trial WHERE trial = ?", (probe,))
        data = json.loads(zlib.decompress(body))
        data["records"][0]["value"] = 0.5
        text = json.dumps(data, sort_keys=True, separators=(",", ":")).encode()
        store.execute("UPDATE trial SET body = ? WHERE trial = ?", (zlib.compress(text), probe))
    with ResultsFolder(out) as store:
        state = out / "files" / f"{store.trial(fit).files[STATE]}.safetensors"
    state.write_bytes(state.read_bytes()[:-1] + b"\0")
    damaged = load_results(out).set_index("trial")
    assert set(damaged.loc[[probe, fit], "status"]) == {"error"}
    assert damaged.loc[[probe, fit], "value"].isna().all()
    assert main(["report", str(out)]) == 0
    assert "0.5 " not in (out / "report" / "status.md").read_text()
    probed, said = go(tmp_path, again=True)
    assert probed == ["Good"], "the state came back as it was"
    assert said.count("set aside and to be measured again: ") == 2
    assert "does not match its checksum" in said
    after = load_results(out)
    untimed = before["measure"] == "probe"
    assert after[untimed].equals(before[untimed])
    assert set(after["status"]) == {"ok"}


# --- the analysis --------------------------------------------------------------------------------


@pytest.fixture
def analysed(tmp_path: Path) -> Path:
    """Results whose fits were analysed by another version, which got a number wrong."""
    go(tmp_path)
    with ResultsFolder(tmp_path / "out", write=True) as store:
        fits = {k: t for k, t in store.trials().items() if t.labels["measure"] == "fit"}
        for key, fit in fits.items():
            assert fit.analysis == renewing.analysis_digest("fit")
            wrong = [{**r, "value": -1.0} for r in fit.records]
            fits[key] = replace(fit, records=wrong, analysis="of before")
        store.save_records(fits)
    return tmp_path


def test_another_analysis_makes_records_anew_and_measures_nothing(analysed: Path):
    out = analysed / "out"
    with ResultsFolder(out) as store:
        before = store.trials()
    assert (load_results(out)["value"] != -1).all(), "a reader makes them for itself"
    with ResultsFolder(out) as store:
        assert str(store.trials()) == str(before), "and writes nothing"
    probed, said = go(analysed, again=True)
    assert probed == [] and "all stored" in said
    with ResultsFolder(out) as store:
        after = store.trials()
    for key, trial in after.items():
        if trial.labels["measure"] == "fit":
            assert trial.analysis == renewing.analysis_digest("fit")
            assert all(record["value"] != -1 for record in trial.records)
            assert trial.started == before[key].started and trial.files == before[key].files
            seconds = float(trial.arrays["fit_seconds"])
            found = {r["metric"]: r["value"] for r in trial.records}["fit-seconds"]
            assert found == seconds


def test_raw_data_that_lack_what_the_analysis_needs_are_stale(analysed: Path):
    out = analysed / "out"
    with ResultsFolder(out, write=True) as store:
        fits = [t for t in store.trials().values() if t.labels["measure"] == "fit"]
        for fit in fits:
            store.save(fit, {"something": np.zeros(1)}, fit.files)
    frame = load_results(out)
    fits = frame[frame["measure"] == "fit"]
    assert set(fits["status"]) == {"stale"}
    assert "the stored raw data do not hold what it needs now" in fits["reason"].iloc[0]
    probed, said = go(analysed, again=True)
    assert "stale: the analysis changed" in said and "2 to do (2 of them fits)" in said
    assert probed == []
    assert set(load_results(out)["status"]) == {"ok"}


# --- harness status ------------------------------------------------------------------------------


def status(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, str]:
    capsys.readouterr()
    code = main(["status", str(folder), *more])
    return code, capsys.readouterr().out


def test_status_of_what_is_valid_and_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    go(tmp_path)
    assert status(tmp_path / "out", capsys) == (0, "fakes: 4 trials: 4 valid\n")
    with ResultsFolder(tmp_path / "out", write=True) as store:
        probe = next(k for k, t in store.trials().items() if t.labels["measure"] == "probe")
        store.set_aside({probe: "for a test"})
    assert status(tmp_path / "out", capsys) == (1, "fakes: 4 trials: 3 valid, 1 missing\n")
    assert status(tmp_path, capsys)[1].startswith("fakes: 4 trials"), "a folder of folders"
    assert main(["status", str(tmp_path / "suite.yaml")]) == 2
    assert "holds no results, and no folder in it does" in capsys.readouterr().err


def test_status_of_what_is_stale_names_the_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    go(tmp_path)
    edit(tmp_path, "torch.full((len(wo),), 1 / math.pi)", "torch.full((len(wo),), 2 / math.pi)")
    make_plan(load(tmp_path / "suite.yaml"))
    from harness.identity.ours import digests

    folder = digests().tree.add_folder(tmp_path)
    digests.cache_clear()
    assert digests().tree.add_folder(tmp_path) == folder
    digests().tree.roots["tests"] = Path(fakes.__file__).parent
    code, said = status(tmp_path / "out", capsys)
    assert code == 1
    assert said.startswith("fakes: 4 trials: 4 stale\n")
    assert "stale: the method changed (" in said and "Good.pdf)" in said
    frame = load_results(tmp_path / "out")
    assert set(frame["status"]) == {"stale"} and frame["value"].notna().all()


def test_status_of_what_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = fakes.suite(tmp_path, **SMALL | {"methods": ["adapters.py:Good", "adapters.py:Raises"]})
    console = Console(file=io.StringIO(), width=200)
    assert run(make_plan(load(path)), tmp_path / "out", Options(), console) == 1
    code, said = status(tmp_path / "out", capsys, "--failed")
    assert code == 1
    assert said.startswith("fakes: 4 trials: 2 valid, 1 failed, 1 skipped\n")
    assert "1 x RuntimeError: no luck" in said and "Traceback" in said


def test_status_of_times_of_another_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    go(tmp_path, measures=["clock"], scenes=["fake-room"])
    assert status(tmp_path / "out", capsys) == (0, "fakes: 4 trials: 4 valid\n")
    monkeypatch.setattr(machine, "identity", lambda device="cpu": {"cpu": "another", "cores": 1})
    code, said = status(tmp_path / "out", capsys)
    # The fits hold times as well.
    assert (code, said) == (0, "fakes: 4 trials: 4 valid, 4 timed on another machine\n")


def test_a_frame_of_stale_results_says_so_in_tables(tmp_path: Path):
    go(tmp_path)
    with ResultsFolder(tmp_path / "out", write=True) as store:
        found = store.trials()
        for trial in found.values():
            trial.parts["measure"] = "of before"
        store.save_records(found)
    results = Results.load(tmp_path / "out")
    assert set(results.frame["status"]) == {"stale"}
    shown = results.number("probe", "mean-pdf", "fake-a", "Good")
    assert not isinstance(shown, str) and shown.note == "stale: the measure changed"
