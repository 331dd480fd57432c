"""A large store, planned and loaded; how long that takes is printed and decides nothing."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from harness import load_results
from harness.core.record import Record
from harness.runner.only import Only
from harness.runner.todo import make_todo
from harness.runner.validity import Validity
from harness.store import code
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored
from harness.suite.load import load
from harness.suite.plan import make_plan
from tests import fakes

TRIALS = 10_000
METHODS, SEEDS = 20, 25


@pytest.mark.slow
def test_ten_thousand_trials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """All are there. Prints processor seconds, for which 5 and 3 are aimed at."""
    fakes.install(monkeypatch.setattr)
    materials = [f"fake-{i}" for i in range(TRIALS // (2 * METHODS * SEEDS))]
    methods = [
        {"name": "adapters.py:Named", "label": f"m{i}", "params": {"scale": float(i)}}
        for i in range(METHODS)
    ]
    path = fakes.suite(
        tmp_path, materials=materials, methods=methods, measures=["probe"], scenes=None,
        baseline="m0", seeds=list(range(SEEDS)),
    )  # fmt: skip
    plan = make_plan(load(path))
    assert len(plan.trials) == TRIALS
    validity, records = Validity(plan, {}), [vars(Record(f"r{j}", float(j))) for j in range(8)]
    (tmp_path / "out").mkdir()
    with ResultsFolder(tmp_path / "out", write=True) as store:
        store.run("PRAGMA synchronous = OFF")
        with store.writing():
            for trial in plan.trials:
                about = Stored(
                    trial.hash, trial.identity, trial.labels, "ok", "", records,
                    parts=validity.parts(trial), entries=validity.entries(trial), seconds=1.0,
                    analysis=validity.analysis(trial.measure), fit=trial.fit,
                )  # fmt: skip
                store.put(about, {}, {})
        rows = [
            {"trial": t.hash, **t.labels, "fit": t.fit, "identity": t.identity} for t in plan.trials
        ]
        store.write_plan({"suite": plan.suite, "baseline": plan.baseline}, rows)
    began = time.process_time()
    plan = make_plan(load(path))
    with ResultsFolder(tmp_path / "out") as store:
        stored = store.trials({trial.hash for trial in plan.trials})
        found = Validity(plan, stored, lambda digest: code.units(store, digest))
        todo = make_todo(plan, stored, found, Only({}))
    planned = time.process_time() - began
    assert not todo.stale and not [t for t in todo.trials if t.measure != "fit"]
    began = time.process_time()
    frame = load_results(tmp_path / "out")
    loaded = time.process_time() - began
    print(f"{TRIALS} trials: planned in {planned:.2f} s, loaded in {loaded:.2f} s")
    assert len(frame) == 8 * TRIALS and set(frame["status"]) == {"ok"}
