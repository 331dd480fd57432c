"""The store: a trial whole or not at all, every planned trial a row, nothing read unchecked."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from harness import load_results
from harness.core.protocol.errors import InputError
from harness.core.record import Record
from harness.measures.base import Outcome
from harness.store import write
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.packing import array_bytes, array_of, pack, plain, plain_array, unpack
from harness.store.publish import rounded
from harness.store.stored import COLUMNS, Stored

HASH, OTHER, THIRD = "0123456789abcdef", "fedcba9876543210", "00000000000000aa"
LABELS = {"suite": "s", "material": "m", "method": "a", "scene": "", "measure": "own", "seed": 0}


def described(name: str = HASH, outcome: Outcome | None = None, **labels: Any) -> Stored:
    status, reason = (outcome.status, outcome.reason) if outcome else ("ok", "")
    return Stored(
        name, {"method": {"name": "a"}}, LABELS | labels, status, reason,
        started="2024-01-01T00:00:00+00:00", seconds=1.5,
    )  # fmt: skip


def save(folder: Path, outcome: Outcome, name: str = HASH, **labels: Any) -> Stored:
    with ResultsFolder(folder, write=True) as store:
        return write.save(store, described(name, outcome, **labels), outcome)


def trial(folder: Path, name: str = HASH) -> Stored:
    with ResultsFolder(folder) as store:
        return store.trial(name)


def plan(folder: Path, *hashes: str) -> None:
    rows = [{"trial": h, **LABELS, "fit": "", "identity": {}} for h in hashes]
    with ResultsFolder(folder, write=True) as store:
        store.write_plan({"suite": "s"}, rows)


def test_everything_comes_back(tmp_path: Path):
    outcome = Outcome(
        records=[Record("kl", 0.5, 0.4, 0.6, "nats"), Record("n", 3.0)],
        arrays={"x": np.arange(6.0).reshape(2, 3).T, "scalar": np.array(3)},
        images={"mean": np.linspace(0, 4, 48).reshape(4, 4, 3)},
        tensors={"w": torch.arange(4).view(2, 2).T, "scalar": torch.tensor(2.0)},
        documents={"note": {"why": ["a", 1, math.inf]}},
    )
    save(tmp_path, outcome)
    assert {p.name for p in tmp_path.iterdir()} == {"results.sqlite", "files"}
    assert sorted(p.suffix for p in (tmp_path / "files").iterdir()) == [".exr", ".safetensors"]
    found = trial(tmp_path)
    assert (found.status, found.seconds, found.labels) == ("ok", 1.5, LABELS)
    assert found.records[0] == {
        "metric": "kl", "value": 0.5, "ci_low": 0.4, "ci_high": 0.6, "unit": "nats"
    }  # fmt: skip
    assert math.isnan(found.records[1]["ci_low"])
    np.testing.assert_array_equal(found.arrays["x"], outcome.arrays["x"])
    assert float(found.arrays["scalar"]) == 3, "a scalar has no dimension"
    np.testing.assert_allclose(found.images["mean"], outcome.images["mean"], rtol=1e-3)
    assert found.documents == {"note": {"why": ["a", 1, "inf"]}}
    state = found.tensors()
    torch.testing.assert_close(state["w"], outcome.tensors["w"])
    assert state["scalar"].shape == ()


SHAPES = arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0)
KINDS = st.sampled_from(["f4", "f8", "i4", "i8", "u1", "?", ">f8", "U3"])


@settings(max_examples=60, deadline=None)
@given(KINDS.flatmap(lambda kind: arrays_of.arrays(kind, SHAPES)))
def test_an_array_comes_back_with_kind_and_shape(array: np.ndarray):
    found = array_of(array_bytes(array))
    assert (found.shape, found.dtype.kind) == (array.shape, array.dtype.kind)
    np.testing.assert_array_equal(found, array)
    assert array_bytes(np.asarray(array, order="F")) == array_bytes(array), (
        "one content, one digest"
    )


@settings(max_examples=60, deadline=None)
@given(arrays_of.arrays("f4", st.integers(0, 50)), st.booleans())
def test_an_array_by_its_steps_is_the_same_array(array: np.ndarray, ordered: bool):
    data = array_bytes(np.sort(array) if ordered else array)
    assert unpack(plain_array(data)) == data
    for spoiled in (b"~" + data[:-1], b"~no array"):
        with suppress(ValueError):
            assert unpack(spoiled) != data


def test_sorted_numbers_take_less_by_their_steps():
    data = array_bytes(rounded(np.sort(np.random.default_rng(3).gamma(0.5, size=400))))
    assert plain_array(data)[:1] == b"~" and len(pack(plain_array(data))) < 0.9 * len(pack(data))
    other = array_bytes(np.random.default_rng(3).standard_normal(400).astype("f4"))
    assert plain_array(other) == plain(other) and plain_array(b"[]") == plain(b"[]")


def test_bytes_are_compressed_with_a_dictionary_or_not_at_all():
    body = b"sampler " * 40
    for packed, dictionary in ((pack(body), b""), (pack(body, body), body), (plain(body), b"")):
        assert unpack(packed, dictionary) == body == unpack(packed, dictionary, len(body))
        with pytest.raises(ValueError, match="is more than 319 bytes"):
            unpack(packed, dictionary, len(body) - 1)
    assert len(pack(body, body)) < len(pack(body)) < len(plain(body))
    with pytest.raises(ValueError, match="cannot be decompressed"):
        unpack(pack(body, body))
    with pytest.raises(ValueError, match="cut off"):
        unpack(pack(body)[:-5])


def test_what_cannot_be_stored_is_refused_and_leaves_the_old(tmp_path: Path):
    save(tmp_path, Outcome(records=[Record("kl", 1.0)]))
    for bad in (
        Outcome(arrays={"x": np.array([object()])}),
        Outcome(arrays={"x": np.zeros(2, [("a", "f4"), ("b", "i4")])}),
        Outcome(documents={"x": object()}),
        Outcome(images={"a/b": np.zeros((2, 2, 3))}),
    ):
        with pytest.raises((TypeError, ValueError)):
            save(tmp_path, bad)
    assert trial(tmp_path).records[0]["value"] == 1.0


def test_an_empty_state_is_a_state(tmp_path: Path):
    save(tmp_path, Outcome(tensors={}))
    assert trial(tmp_path).has_state
    save(tmp_path, Outcome(), OTHER)
    assert not trial(tmp_path, OTHER).has_state
    with pytest.raises(InputError, match="holds no state"):
        trial(tmp_path, OTHER).tensors()


def test_infinities_come_back(tmp_path: Path):
    save(tmp_path, Outcome(records=[Record("kl", math.inf, -math.inf, math.nan)]))
    record = trial(tmp_path).records[0]
    assert (record["value"], record["ci_low"]) == (math.inf, -math.inf)
    assert math.isnan(record["ci_high"])


def test_a_new_outcome_replaces_the_old_one_whole(tmp_path: Path):
    broke = Outcome("error", "broke", {"x": np.ones(1)}, {"i": np.ones((2, 2, 3))}, traceback="T")
    save(tmp_path, broke)
    assert trial(tmp_path).traceback == "T"
    save(tmp_path, Outcome(records=[Record("kl", 1.0)]))
    found = trial(tmp_path)
    assert (found.status, found.reason, found.traceback) == ("ok", "", "")
    assert (found.arrays, found.files) == ({}, {})
    with ResultsFolder(tmp_path, write=True) as store:
        store.tidy()
        assert store.keys() == {HASH}
    assert list((tmp_path / "files").iterdir()) == []


def test_equal_content_is_kept_once(tmp_path: Path):
    for name in (HASH, OTHER, THIRD):
        save(tmp_path, Outcome(arrays={"x": np.ones(9)}, images={"i": np.ones((2, 2, 3))}), name)
    assert len(list((tmp_path / "files").iterdir())) == 1
    with ResultsFolder(tmp_path, write=True) as store:
        (count,) = store._connection.execute("SELECT count(*) FROM blob").fetchone()
        assert count == 1
        store.set_aside({HASH: "for a test"})
        store.tidy()
    assert trial(tmp_path, OTHER).images.keys() == {"i"}


def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path: Path):
    save(tmp_path, Outcome(images={"i": np.ones((2, 2, 3))}))
    (kept,) = (tmp_path / "files").iterdir()
    left = [tmp_path / "files" / name for name in (".tmp-1.exr", f"{'0' * 32}.exr")]
    mine = tmp_path / "files" / "note.txt"
    for path in (*left, mine):
        path.write_text("x")
    with ResultsFolder(tmp_path, write=True) as store:
        store.tidy()
    assert set((tmp_path / "files").iterdir()) == {kept, mine}


def test_every_planned_trial_is_a_row(tmp_path: Path):
    plan(tmp_path, HASH, OTHER, THIRD)
    save(tmp_path, Outcome(records=[Record("a", 1.0), Record("b", 2.0)]))
    save(tmp_path, Outcome("error", "broke"), OTHER)
    frame = load_results(tmp_path)
    assert list(frame.columns) == COLUMNS
    assert list(frame["status"]) == ["ok", "ok", "error", "skipped"]
    assert list(frame["reason"]) == ["", "", "broke", "not run yet"]
    assert list(frame["metric"]) == ["a", "b", "", ""]
    assert frame["value"].dtype == float
    assert frame["value"].isna().tolist() == [False, False, True, True]
    assert trial(tmp_path, THIRD).status == "skipped"


def test_only_the_bad_rows_of_a_nonfinite_trial_say_so(tmp_path: Path):
    plan(tmp_path, HASH)
    records = [Record("kl", math.nan), Record("chi2", math.inf), Record("mse", 0.5)]
    save(tmp_path, Outcome("nonfinite", "kl is nan", records=records))
    frame = load_results(tmp_path)
    assert list(frame["status"]) == ["nonfinite", "ok", "ok"]
    assert list(frame["reason"]) == ["kl is nan", "", ""]


def test_trials_of_earlier_plans_are_left_out_unless_asked_for(tmp_path: Path):
    plan(tmp_path, HASH)
    save(tmp_path, Outcome(records=[Record("a", 1.0)]), OTHER, method="old")
    assert list(load_results(tmp_path)["trial"]) == [HASH]
    frame = load_results(tmp_path, all=True)
    assert list(frame["trial"]) == [HASH, OTHER]
    assert list(frame["method"]) == ["a", "old"]


def test_labels_of_the_plan_win(tmp_path: Path):
    # Two suites, or two labels, may share one trial.
    plan(tmp_path, HASH)
    save(tmp_path, Outcome(), method="former label")
    assert list(load_results(tmp_path)["method"]) == ["a"]


def test_many_keys_and_few_are_the_same_trials(tmp_path: Path):
    names = [f"{i:016x}" for i in range(600)]
    with ResultsFolder(tmp_path, write=True) as store:
        for name in names[:5]:
            write.save(store, described(name), Outcome(arrays={"x": np.ones(2)}))
        assert store.trials(names).keys() == store.trials(names[:5]).keys() == set(names[:5])
        assert store.trials([]) == {}


def test_refusals(tmp_path: Path):
    with pytest.raises(InputError, match="holds no results .there is no results.sqlite"):
        load_results(tmp_path)
    save(tmp_path, Outcome())
    with pytest.raises(InputError, match="holds no plan yet; run the suite first"):
        load_results(tmp_path)
    plan(tmp_path, HASH)
    with pytest.raises(InputError, match="no trial 'x'"):
        trial(tmp_path, "x")


def test_one_run_at_a_time(tmp_path: Path):
    refused = pytest.raises(InputError, match="another run is writing there")
    with locked(tmp_path), refused, locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def test_a_reader_writes_nothing(tmp_path: Path):
    save(tmp_path, Outcome())
    with ResultsFolder(tmp_path) as store, pytest.raises(InputError, match="read-only"):
        store.write_plan({}, [])
