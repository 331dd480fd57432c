"""Trials that are lost without a trace, stores with more than they should have, fits again."""

from __future__ import annotations

import sqlite3
import zlib
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from harness import load_results
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.store.database import FILE
from harness.store.folder import ResultsFolder
from harness.store.forms import checked_body, checked_plan
from harness.store.lock import locked
from harness.store.mend import mend
from harness.store.packing import MOST_TEXT, pack, unpack
from tests import fakes, stores
from tests.stores import KEYS


def sql(folder: Path, statement: str, *values: object) -> list[tuple]:
    """Behind the store's back."""
    with closing(sqlite3.connect(folder / FILE)) as connection, connection:
        return connection.execute(statement, values).fetchall()


def lost(folder: Path) -> str:
    with ResultsFolder(folder) as store:
        return store.lost()


def test_a_row_that_is_lost_is_said_and_measured_again(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    sql(folder, "DELETE FROM trial WHERE trial = ?", KEYS[1])
    frame = load_results(folder)
    assert list(frame["status"]) == ["ok", "error", "ok"]
    assert "are not there any more; harness run measures them again" in frame["reason"][1]
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
        mend(folder, said.append)
    assert len(said) == 1 and "trials that were stored are not there" in said[0]
    assert list(load_results(folder)["status"]) == ["ok", "skipped", "ok"]


def test_a_row_of_another_time_is_noticed(tmp_path: Path):
    """It is whole and has its checksum, and is not what was stored last."""
    folder = stores.make(tmp_path / "out")
    old = sql(folder, "SELECT checksum, body FROM trial WHERE trial = ?", KEYS[0])[0]
    with ResultsFolder(folder, write=True) as store:
        stores.save(store, KEYS[0], 5)
    sql(folder, "UPDATE trial SET checksum = ?, body = ? WHERE trial = ?", *old, KEYS[0])
    assert lost(folder)


def test_all_that_a_store_does_keeps_count(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    with ResultsFolder(folder, write=True) as store:
        stores.save(store, KEYS[0], 7)
        stores.save(store, "a" * 16, 8)
        trial = store.trial(KEYS[1])
        store.save_records({KEYS[1]: replace(trial, reason="made again")})
        store.set_aside({KEYS[2]: "for a test", "b" * 16: "not there"})
        store.tidy()
        with pytest.raises(TypeError), store.writing():
            store.put(replace(trial, documents={"x": object()}), {}, {})
        assert store.lost() == ""
    sql(folder, "UPDATE meta SET value = 'odd' WHERE name = 'census'")
    assert lost(folder)


def test_a_store_from_before_counts_from_the_next_trial_on(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    sql(folder, "DELETE FROM meta WHERE name = 'census'")
    assert lost(folder) == "" and set(load_results(folder)["status"]) == {"ok"}
    with ResultsFolder(folder, write=True) as store:
        stores.save(store, "a" * 16, 8)
    assert lost(folder) == ""
    sql(folder, "DELETE FROM trial WHERE trial = ?", KEYS[0])
    assert lost(folder)


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW odd AS SELECT 1",
        "CREATE TRIGGER odd AFTER INSERT ON trial BEGIN DELETE FROM trial; END",
        "ALTER TABLE trial ADD COLUMN more TEXT",
        "DROP TABLE probe",
    ],
)
def test_a_store_with_more_or_less_in_it_is_rebuilt(tmp_path: Path, statement: str):
    folder = stores.make(tmp_path / "out")
    sql(folder, statement)
    with pytest.raises(InputError, match="its tables are not those of this format"):
        load_results(folder)
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
    assert "what can be read is taken over" in said[0]
    if "COLUMN" not in statement:
        assert list(load_results(folder)["value"]) == [0.0, 1.0, 2.0]


def test_little_that_stands_for_much_is_damage(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    bomb = zlib.compress(bytes(2 * MOST_TEXT), 9)
    assert len(bomb) < MOST_TEXT / 100
    sql(folder, "UPDATE trial SET body = ? WHERE trial = ?", bomb, KEYS[0])
    assert list(load_results(folder)["status"]) == ["error", "ok", "ok"]
    sql(folder, "UPDATE text SET body = ?", bomb)
    with pytest.raises(InputError, match="plan is damaged: is more than 8,388,608 bytes"):
        load_results(folder)
    with pytest.raises(ValueError, match="is more than 8,388,608 bytes, decompressed"):
        unpack(bomb, most=MOST_TEXT)
    with pytest.raises(ValueError, match="too many to be stored"):
        pack(bytes(MOST_TEXT + 1), most=MOST_TEXT)


GOOD = {
    "trial_key": "a", "status": "ok", "arrays": {}, "files": {"x.exr": "1"}, "seconds": 1.5,
    "labels": stores.labels(1), "trial": {"method": "1"},
    "records": [{"metric": "m", "unit": "", "value": 1, "ci_low": "nan", "ci_high": "-inf"}],
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("status", "fine"), ("status", None), ("records", {}), ("records", [{"metric": 1}]),
        ("labels", {"suite": 1}), ("arrays", {"x": 1}), ("files", []), ("seconds", "1"),
        ("trial", []), ("more", 1), ("reason", 3), ("parts", {"a": None}),
    ],
)  # fmt: skip
def test_a_body_of_another_form_is_none(key: str, value: object):
    assert checked_body(GOOD) == GOOD
    with pytest.raises(ValueError, match=key):
        checked_body(GOOD | {key: value})
    with pytest.raises(ValueError, match="no mapping"):
        checked_body([GOOD])


@pytest.mark.parametrize(
    "change",
    [
        {"trials": {}}, {"trials": [1]}, {"trials": [{"trial": "a"}]}, {"suite": 1},
        {"report": {"tables": "all"}}, {"report": []},
    ],
)  # fmt: skip
def test_a_plan_of_another_form_is_none(change: dict):
    row = {"trial": "a", **stores.labels(1), "fit": "", "identity": {"method": "1"}}
    good = {"suite": "s", "trials": [row], "report": {"tables": None, "figures": ["x"]}}
    assert checked_plan(good) == good
    with pytest.raises(ValueError, match="it|its"):
        checked_plan(good | change)


def test_a_damaged_fit_is_fitted_again_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    fakes.install(monkeypatch.setattr)
    suite, out = fakes.suite(tmp_path), tmp_path / "out"
    assert main(["run", str(suite), "--out", str(out)]) == 0
    before = load_results(out)
    (state, *_) = sorted((out / "files").glob("*.safetensors"))
    data = bytearray(state.read_bytes())
    data[-1] ^= 1  # a bit of a weight
    state.write_bytes(data)
    assert "error" in set(load_results(out)["status"])
    capsys.readouterr()
    assert main(["run", str(suite), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{state.name}: does not match its checksum" in " ".join(said.split())
    after = load_results(out)
    untimed = ~before["metric"].str.contains("seconds")
    assert after[untimed].equals(before[untimed]) and set(after["status"]) == {"ok"}
