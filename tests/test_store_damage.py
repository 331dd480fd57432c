"""What is damaged in a store is never shown as a number, is set aside and can be stored again."""

from __future__ import annotations

import json
import os
import sqlite3
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from harness import load_results
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.store.damage import damage as damage_of
from harness.store.database import FILE, MARK
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.mend import mend
from tests import stores
from tests.stores import KEYS

FIRST, SECOND, THIRD = KEYS


def sql(folder: Path, statement: str, *values: object) -> list[tuple]:
    """Behind the store's back."""
    with closing(sqlite3.connect(folder / FILE)) as connection, connection:
        return connection.execute(statement, values).fetchall()


def flipped(data: bytes) -> bytes:
    """One bit in the middle is another."""
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


def flip(folder: Path, table: str, key: str, digest: str) -> None:
    ((body,),) = sql(folder, f"SELECT body FROM {table} WHERE {key} = ?", digest)
    sql(folder, f"UPDATE {table} SET body = ? WHERE {key} = ?", flipped(body), digest)


def body_of(folder: Path, key: str) -> dict:
    ((body,),) = sql(folder, "SELECT body FROM trial WHERE trial = ?", key)
    return json.loads(zlib.decompress(body))


def a_body(folder: Path) -> None:
    flip(folder, "trial", "trial", FIRST)


def an_array(folder: Path) -> None:
    flip(folder, "blob", "digest", body_of(folder, FIRST)["arrays"]["numbers"])


def a_lost_array(folder: Path) -> None:
    sql(folder, "DELETE FROM blob WHERE digest = ?", body_of(folder, FIRST)["arrays"]["numbers"])


def another_array(folder: Path) -> None:
    """It is whole, and another trial's."""
    own, others = (body_of(folder, key)["arrays"]["numbers"] for key in (FIRST, SECOND))
    ((body,),) = sql(folder, "SELECT body FROM blob WHERE digest = ?", others)
    sql(folder, "UPDATE blob SET body = ? WHERE digest = ?", body, own)


def a_text(folder: Path) -> None:
    flip(folder, "text", "digest", body_of(folder, FIRST)["documents"]["about"])


def a_file(folder: Path) -> None:
    path = folder / "files" / f"{body_of(folder, FIRST)['files']['flat.exr']}.exr"
    path.write_bytes(flipped(path.read_bytes()))


def a_lost_file(folder: Path) -> None:
    (folder / "files" / f"{body_of(folder, FIRST)['files']['flat.exr']}.exr").unlink()


def a_value(folder: Path) -> None:
    """Somebody edits a number."""
    body = body_of(folder, FIRST)
    body["records"][0]["value"] = 42.0
    text = json.dumps(body, sort_keys=True, separators=(",", ":")).encode()
    sql(folder, "UPDATE trial SET body = ? WHERE trial = ?", zlib.compress(text), FIRST)


def a_status(folder: Path) -> None:
    ((body,),) = sql(folder, "SELECT body FROM trial WHERE trial = ?", FIRST)
    text = zlib.decompress(body).replace(b'"status":"ok"', b'"status":"unsupported"')
    sql(folder, "UPDATE trial SET body = ? WHERE trial = ?", zlib.compress(text), FIRST)


DAMAGES = [
    a_body, an_array, a_lost_array, another_array, a_text, a_file, a_lost_file,
    a_value, a_status,
]  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_damage_is_an_error_row_then_set_aside_then_stored_again(
    tmp_path: Path, damage: Callable[[Path], None]
):
    folder = stores.make(tmp_path / "out")
    damage(folder)
    frame = load_results(folder)
    assert list(frame["trial"]) == [FIRST, SECOND, THIRD]
    assert list(frame["status"]) == ["error", "ok", "ok"]
    assert frame["value"].isna().tolist() == [True, False, False]
    reason = frame["reason"][0]
    assert "\n" not in reason and "harness run m" in reason
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
    assert said == [f"set aside and to be measured again: {reason}"]
    assert list(load_results(folder)["status"]) == ["skipped", "ok", "ok"]
    ((kept, why),) = sql(folder, "SELECT trial, reason FROM damaged")
    assert (kept, why) == (FIRST, reason)
    with locked(folder):
        mend(folder, said.append)
        assert len(said) == 1, "there is nothing more to say"
        with ResultsFolder(folder, write=True) as store:
            stores.save(store, FIRST, 0)
    frame = load_results(folder)
    assert (list(frame["status"]), list(frame["value"])) == (["ok"] * 3, [0.0, 1.0, 2.0])
    with ResultsFolder(folder) as store:
        assert damage_of(store) == {}
        assert store.trial(FIRST).documents == {"about": "trial 0"}
        assert store.arrays(FIRST)["numbers"].tolist() == [0.0] * 64


def test_two_bodies_that_changed_places_are_noticed(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    rows = {t: (c, b) for t, c, b in sql(folder, "SELECT trial, checksum, body FROM trial")}
    for to, of in ((FIRST, SECOND), (SECOND, FIRST)):
        sql(folder, "UPDATE trial SET checksum = ?, body = ? WHERE trial = ?", *rows[of], to)
    frame = load_results(folder)
    assert list(frame["status"]) == ["error", "error", "ok"]
    assert "it is another trial's" in frame["reason"][0]
    assert frame["value"].isna().tolist() == [True, True, False]


def test_an_array_that_trials_share_takes_all_of_them(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    flip(folder, "blob", "digest", body_of(folder, FIRST)["arrays"]["all"])
    assert list(load_results(folder)["status"]) == ["error"] * 3


def test_a_damaged_plan_is_refused_and_written_again(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    ((plan,),) = sql(folder, "SELECT value FROM meta WHERE name = 'plan'")
    other = zlib.compress(zlib.decompress(plan).replace(b"method-1", b"another"))
    sql(folder, "UPDATE meta SET value = ? WHERE name = 'plan'", other)
    with pytest.raises(InputError, match="the stored plan is damaged.*harness run writes it again"):
        load_results(folder)
    stores.make(folder)
    assert list(load_results(folder)["method"]) == ["method-0", "method-1", "method-2"]
    ((plan,),) = sql(folder, "SELECT value FROM meta WHERE name = 'plan'")
    row = json.loads(zlib.decompress(plan))["trials"][0]
    flip(folder, "text", "digest", row["identity"]["number"])
    with pytest.raises(InputError, match="the stored plan is damaged: .*; harness run writes"):
        load_results(folder)
    stores.make(folder)
    assert list(load_results(folder)["status"]) == ["ok"] * 3


def many(folder: Path) -> tuple[Path, list[str]]:
    """A store of 40 trials and some 100 pages."""
    keys = [f"{number:016x}" for number in range(40)]
    return stores.make(folder, keys, noise=1000), keys


def test_a_page_that_is_overwritten_costs_what_was_on_it(tmp_path: Path):
    folder, keys = many(tmp_path / "out")
    path = folder / FILE
    size = path.stat().st_size
    page = 4096
    noise = os.urandom(page)
    with path.open("r+b") as file:
        file.seek(size // page // 2 * page)
        file.write(noise)
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
    assert said, "it is noticed"
    with ResultsFolder(folder) as store:
        store.check()
        assert damage_of(store) == {}
        found = store.trials()
        assert all(t.records[0]["value"] == keys.index(k) for k, t in found.items())
        assert len(found) > 20, "the larger part is taken over"


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9])
def test_a_file_cut_short_is_rebuilt_of_what_is_readable(tmp_path: Path, share: float, capsys):
    folder, keys = many(tmp_path / "out")
    path = folder / FILE
    os.truncate(path, int(share * path.stat().st_size))
    for verb in ("report", "status"):
        assert main([verb, str(folder)]) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
    assert said and all("\n" not in line for line in said)
    if share:
        assert "what can be read is taken over" in said[0]
        assert len(list(folder.glob(f"{FILE}.damaged-*"))) == 1, "nothing is thrown away"
    with ResultsFolder(folder, write=True) as store:
        store.check()
        assert damage_of(store) == {}
        assert store.keys() <= set(keys)
        stores.save(store, keys[0], 0)
        assert store.trial(keys[0]).records[0]["value"] == 0


def test_a_file_overwritten_from_its_start_is_ours_by_what_lies_beside_it(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    with (folder / FILE).open("r+b") as file:
        file.write(b"\0" * 4096)
    with pytest.raises(InputError, match="is damaged .*; harness run sets it aside"):
        load_results(folder)
    said: list[str] = []
    with locked(folder):
        mend(folder, said.append)
    assert "was damaged; kept as results.sqlite.damaged-" in said[0]
    with ResultsFolder(folder) as store:
        assert store.trials() == {}


def test_a_journal_of_the_damaged_file_does_not_reach_the_new_one(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    (folder / FILE).write_bytes(b"no database at all" * 500)
    (folder / f"{FILE}-journal").write_bytes(os.urandom(2048))
    with locked(folder):
        mend(folder, lambda text: None)
        with ResultsFolder(folder, write=True) as store:
            stores.save(store, FIRST, 0)
    with ResultsFolder(folder) as store:
        assert store.keys() == {FIRST}


def test_the_mark_is_where_sqlite_keeps_it(tmp_path: Path):
    folder = stores.make(tmp_path / "out")
    assert sql(folder, "PRAGMA application_id") == [(MARK,)]
