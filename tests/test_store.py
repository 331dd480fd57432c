"""The store: whole folders or none, every planned trial a row."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from harness import load_results
from harness.core.protocol.errors import InputError
from harness.core.record import Record
from harness.measures.base import Outcome
from harness.store import trials as store

HASH, OTHER, THIRD = "0123456789abcdef", "fedcba9876543210", "00000000000000aa"
LABELS = {"suite": "s", "material": "m", "method": "a", "scene": "", "measure": "pdf", "seed": 0}


def described(name: str = HASH, **labels: Any) -> dict[str, Any]:
    return {
        "trial": name,
        "labels": LABELS | labels,
        "identity": {"method": {"name": "a"}},
        "environment": {},
        "started": "2024-01-01T00:00:00+00:00",
        "seconds": 1.5,
    }


def plan(folder: Path, *hashes: str) -> None:
    rows = [{"trial": h, **LABELS, "fit": "", "identity": {}} for h in hashes]
    store.write_plan(folder, {"suite": "s"}, rows)


def test_everything_comes_back(tmp_path: Path):
    outcome = Outcome(
        records=[Record("kl", 0.5, 0.4, 0.6, "nats"), Record("n", 3.0)],
        arrays={"x": np.arange(6.0).reshape(2, 3)},
        images={"mean": np.linspace(0, 4, 48).reshape(4, 4, 3)},
        tensors={"w": torch.arange(4).view(2, 2).T, "scalar": torch.tensor(2.0)},
    )
    folder = store.save_trial(tmp_path, described(), outcome)
    assert {p.name for p in folder.iterdir()} == {
        "trial.json", "arrays.npz", "images", "state.safetensors"
    }  # fmt: skip
    found = store.load_trial(tmp_path, HASH)
    assert found.status == "ok"
    assert found.records[0] == {
        "metric": "kl", "value": 0.5, "ci_low": 0.4, "ci_high": 0.6, "unit": "nats"
    }  # fmt: skip
    assert math.isnan(found.records[1]["ci_low"])
    np.testing.assert_array_equal(found.arrays["x"], outcome.arrays["x"])
    np.testing.assert_allclose(found.images["mean"], outcome.images["mean"], rtol=1e-3)
    state = found.tensors()
    torch.testing.assert_close(state["w"], outcome.tensors["w"])
    assert state["scalar"].shape == ()


def test_an_empty_state_is_a_state(tmp_path: Path):
    store.save_trial(tmp_path, described(), Outcome(tensors={}))
    assert store.load_trial(tmp_path, HASH).has_state
    store.save_trial(tmp_path, described(OTHER), Outcome())
    assert not store.load_trial(tmp_path, OTHER).has_state


def test_infinities_are_valid_json(tmp_path: Path):
    outcome = Outcome(records=[Record("kl", math.inf, -math.inf, math.nan)])
    folder = store.save_trial(tmp_path, described(), outcome)
    json.loads((folder / "trial.json").read_text(), parse_constant=pytest.fail)
    record = store.load_trial(tmp_path, HASH).records[0]
    assert (record["value"], record["ci_low"]) == (math.inf, -math.inf)
    assert math.isnan(record["ci_high"])


def test_a_new_outcome_replaces_the_old_folder(tmp_path: Path):
    store.save_trial(tmp_path, described(), Outcome("error", "broke", arrays={"x": np.ones(1)}))
    store.save_trial(tmp_path, described(), Outcome(records=[Record("kl", 1.0)]))
    found = store.load_trial(tmp_path, HASH)
    assert (found.status, found.arrays) == ("ok", {})
    assert [p.name for p in tmp_path.iterdir()] == [HASH]


def test_scratch_files_stay(tmp_path: Path):
    (store.scratch(tmp_path, HASH) / "note.txt").write_text("x")
    assert store.stored(tmp_path) == []
    folder = store.save_trial(tmp_path, described(), Outcome())
    assert (folder / "note.txt").read_text() == "x"


def test_clean_up_after_a_kill(tmp_path: Path):
    (tmp_path / f".tmp-{HASH}-1").mkdir()
    (tmp_path / f".tmp-{HASH}-1" / "arrays.npz").write_text("half")
    # Killed between stepping aside and stepping in: the old result must come back.
    store.save_trial(tmp_path, described(OTHER), Outcome())
    (tmp_path / OTHER).rename(tmp_path / f".old-{OTHER}-1")
    # Killed before the old one was removed: the new one stays.
    store.save_trial(tmp_path, described(THIRD), Outcome(reason="new"))
    (tmp_path / f".old-{THIRD}-1").mkdir()
    (tmp_path / ".plan.json-1").write_text("{")
    store.clean(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [THIRD, OTHER]
    assert store.load_trial(tmp_path, THIRD).reason == "new"


def test_every_planned_trial_is_a_row(tmp_path: Path):
    plan(tmp_path, HASH, OTHER, THIRD)
    store.save_trial(tmp_path, described(), Outcome(records=[Record("a", 1.0), Record("b", 2.0)]))
    store.save_trial(tmp_path, described(OTHER), Outcome("error", "broke"))
    frame = load_results(tmp_path)
    assert list(frame.columns) == store.COLUMNS
    assert list(frame["status"]) == ["ok", "ok", "error", "skipped"]
    assert list(frame["reason"]) == ["", "", "broke", "not run yet"]
    assert list(frame["metric"]) == ["a", "b", "", ""]
    assert frame["value"].dtype == float
    assert frame["value"].isna().tolist() == [False, False, True, True]
    assert store.load_trial(tmp_path, THIRD).status == "skipped"


def test_only_the_bad_rows_of_a_nonfinite_trial_say_so(tmp_path: Path):
    plan(tmp_path, HASH)
    records = [Record("kl", math.nan), Record("chi2", math.inf), Record("mse", 0.5)]
    store.save_trial(tmp_path, described(), Outcome("nonfinite", "kl is nan", records))
    frame = load_results(tmp_path)
    assert list(frame["status"]) == ["nonfinite", "ok", "ok"]
    assert list(frame["reason"]) == ["kl is nan", "", ""]


def test_stale_trials_are_left_out_unless_asked_for(tmp_path: Path):
    plan(tmp_path, HASH)
    store.save_trial(tmp_path, described(OTHER, method="old"), Outcome(records=[Record("a", 1.0)]))
    assert list(load_results(tmp_path)["trial"]) == [HASH]
    frame = load_results(tmp_path, all=True)
    assert list(frame["trial"]) == [HASH, OTHER]
    assert list(frame["method"]) == ["a", "old"]


def test_labels_of_the_plan_win(tmp_path: Path):
    # Two suites, or two labels, may share one trial.
    plan(tmp_path, HASH)
    store.save_trial(tmp_path, described(method="former label"), Outcome())
    assert list(load_results(tmp_path)["method"]) == ["a"]


def test_refusals(tmp_path: Path):
    with pytest.raises(InputError, match="holds no results"):
        load_results(tmp_path)
    with pytest.raises(InputError, match="holds no results"):
        store.load_trial(tmp_path, HASH)
    plan(tmp_path, HASH)
    with pytest.raises(InputError, match="no trial 'x'"):
        store.load_trial(tmp_path, "x")
    (tmp_path / HASH).mkdir()
    (tmp_path / HASH / "trial.json").write_text("{")
    with pytest.raises(InputError, match="trial.json: cannot be read"):
        load_results(tmp_path)
    (tmp_path / HASH / "trial.json").write_text('{"trial": "x"}')
    with pytest.raises(InputError, match="not a stored trial: KeyError 'identity'"):
        load_results(tmp_path)


def test_one_writer_at_a_time(tmp_path: Path):
    refused = pytest.raises(InputError, match="another run")
    with store.locked(tmp_path), refused, store.locked(tmp_path):
        pass
    with store.locked(tmp_path):
        pass
