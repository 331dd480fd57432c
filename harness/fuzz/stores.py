"""Spoiled results folders: bytes, pages, rows and files; no table may change in silence."""

from __future__ import annotations

import shutil
import sqlite3
import weakref
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from random import Random
from typing import Any

from harness.analysis.results import Results
from harness.core.protocol.errors import InputError
from harness.fuzz import mutations, synthetic
from harness.fuzz.attempt import Fuzz, Wrong
from harness.report.formats.csv import csv
from harness.report.write import Report
from harness.store.database import FILE
from harness.store.files import FOLDER
from harness.store.lock import locked
from harness.store.mend import mend

_PAGE = 4096
_TABLES = ("meta", "text", "trial", "blob", "damaged", "units", "probe", "equivalent")
_BOMB = 300 * 2**20
"""Bytes that a small body stands for."""


class Stores(Fuzz):
    """Each is read as ``harness report`` does, then mended as ``harness run`` does, and read."""

    def __init__(self, folder: Path):
        super().__init__(folder)
        self.whole = folder.with_name(f"{folder.name}-whole")
        synthetic.make(self.whole, image=_picture())
        self.rows = _rows(Results.load(self.whole))
        self.bomb = zlib.compress(bytes(_BOMB), 9)
        weakref.finalize(self, shutil.rmtree, self.whole, ignore_errors=True)

    def attempt(self, rng: Random) -> None:
        """See :class:`Fuzz`."""
        results = self.folder / "results"
        shutil.copytree(self.whole, results)
        self._spoil(results, rng)
        refused = None
        try:
            self._read(results, rng)
        except InputError as error:
            refused = error
        said: list[str] = []
        with locked(results):
            mend(results, said.append)
            try:
                mended = Results.load(results)
            except InputError:
                if not said and refused is None:
                    raise Wrong("mended in silence, and not readable") from None
            else:  # else the plan is lost, and the next run writes it
                self._compare(mended, bool(said))
        if refused is not None:
            raise refused

    def _read(self, results: Path, rng: Random) -> None:
        found = Results.load(results)
        self._compare(found, False)
        if rng.random() < 0.3:
            for table in Report.of(found).tables:
                csv(table)
        whole = [trial for trial in found.found.values() if trial.status == "ok"]
        for trial in rng.sample(whole, min(3, len(whole))):
            _ = trial.arrays, trial.images

    def _compare(self, results: Results, said: bool) -> None:
        """Every planned row is as it was, or an error with its reason; or not there, if said."""
        found = _rows(results)
        for place, row in self.rows.items():
            now = found.get(place)
            if now == row:
                continue
            others = [r for p, r in found.items() if p[:-1] == place[:-1]]
            if now is None and others and all(_is_refused(r, said) for r in others):
                continue
            raise Wrong(f"{place}: was {row}, is {now or others or 'not there'}")
        for place, row in found.items():
            if place not in self.rows and not _is_refused(row, said):
                raise Wrong(f"{place}: was not there, is {row}")

    def _spoil(self, results: Path, rng: Random) -> None:
        kinds: list[Callable[[Path, Random], None]] = [
            _bytes, _bytes, _page, _page, _cut, _row, _row, _row, self._bomb, _beside, _flip,
            _flip, _schema,
        ]  # fmt: skip
        rng.choice(kinds)(results, rng)

    def _bomb(self, results: Path, rng: Random) -> None:
        table = rng.choice(("trial", "text", "blob", "meta"))
        column = "value" if table == "meta" else "body"
        where = " WHERE rowid = 1" if table == "blob" or rng.random() < 0.5 else ""
        _sql(results, f"UPDATE {table} SET {column} = ?{where}", self.bomb)


def _is_refused(row: tuple, said: bool) -> bool:
    status, value, reason = row
    if status == "skipped":
        return said  # a run that mends says so, and measures it again
    return status == "error" and value == "nan" and bool(reason)


def _rows(results: Results) -> dict[tuple, tuple]:
    """``(status, value, reason)`` by labels and metric."""
    keys = ("material", "method", "scene", "measure", "seed", "trial", "metric")
    return {
        tuple(row[key] for key in keys): (
            row["status"],
            f"{row['value']!r}" if row["value"] == row["value"] else "nan",
            row["reason"],
        )
        for row in results.frame.to_dict("records")
    }


def _bytes(results: Path, rng: Random) -> None:
    path = results / FILE
    path.write_bytes(mutations.damaged(path.read_bytes(), rng))


def _flip(results: Path, rng: Random) -> None:
    """One bit of the database or of a file beside it."""
    paths = [results / FILE, *sorted((results / FOLDER).iterdir())]
    path = paths[0] if rng.random() < 0.7 else rng.choice(paths)
    data = bytearray(path.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(data)


def _page(results: Path, rng: Random) -> None:
    """Pages of noise, of nothing, or in each other's places."""
    path = results / FILE
    data = bytearray(path.read_bytes())
    a, b = (rng.randrange(len(data) // _PAGE) * _PAGE for _ in range(2))
    kind = rng.randrange(4)
    if kind == 0:
        data[a : a + _PAGE] = rng.randbytes(_PAGE)
    elif kind == 1:
        data[a : a + _PAGE] = bytes(_PAGE)
    elif kind == 2:
        data[a : a + _PAGE], data[b : b + _PAGE] = data[b : b + _PAGE], data[a : a + _PAGE]
    else:
        data[a : a + _PAGE] = data[b : b + _PAGE]
    path.write_bytes(data)


def _cut(results: Path, rng: Random) -> None:
    path = results / FILE
    data = path.read_bytes()
    size = rng.randrange(len(data))
    path.write_bytes(data[: size - size % _PAGE if rng.random() < 0.5 else size])


def _row(results: Path, rng: Random) -> None:
    """Rows lost, exchanged, doubled under another key, or with another type in a column."""
    table = rng.choice(_TABLES)
    rows = _sql(results, f"SELECT * FROM {table}")
    if not rows:
        return
    names = [row[1] for row in _sql(results, f"PRAGMA table_info({table})")]
    one, other = rng.choice(rows), rng.choice(rows)
    column = rng.choice(names)
    at = names.index(column)
    key, where = one[0], f"WHERE {names[0]} = ?"
    kind = rng.randrange(6)
    if kind == 0:
        _sql(results, f"DELETE FROM {table} {where}", key)
    elif kind == 1 and table != "probe":
        _sql(results, f"UPDATE OR REPLACE {table} SET {column} = ? {where}", other[at], key)
    elif kind == 2:
        for name, value in zip(names[1:], other[1:], strict=True):
            _sql(results, f"UPDATE {table} SET {name} = ? {where}", value, key)
    elif kind == 3:
        odd: Any = rng.choice(
            (b"", b"\xff\xfe", "text", 7, 1.5, -(2**63), "\ud7ff", "a\0b", b"x" * 10**6)
        )
        _sql(results, f"UPDATE OR REPLACE {table} SET {column} = ? {where}", odd, key)
    elif kind == 4:
        body = one[at]
        spoiled = _repacked(body, rng) if isinstance(body, bytes) else f"{body}x"
        _sql(results, f"UPDATE OR REPLACE {table} SET {column} = ? {where}", spoiled, key)
    else:
        _sql(results, f"DELETE FROM {table}")


def _repacked(body: bytes, rng: Random) -> bytes:
    """What it holds changed, and compressed again: a number edited, a word another."""
    try:
        plain = zlib.decompress(body)
    except zlib.error:
        return mutations.damaged(body, rng)
    for old, new in ((b'"value":', b'"value":1'), (b'"ok"', b'"unsupported"')):
        if old in plain and rng.random() < 0.5:
            return zlib.compress(plain.replace(old, new))
    return zlib.compress(mutations.damaged(plain, rng))


def _beside(results: Path, rng: Random) -> None:
    """Files beside the database: lost, damaged, folders in their place, a journal of nothing."""
    paths = sorted((results / FOLDER).iterdir())
    path = rng.choice(paths)
    kind = rng.randrange(6)
    if kind == 0:
        path.unlink()
    elif kind == 1:
        path.write_bytes(mutations.damaged(path.read_bytes(), rng))
    elif kind == 2:
        path.unlink()
        path.mkdir()
    elif kind == 3:
        shutil.rmtree(results / FOLDER)
    elif kind == 4:
        (results / f"{FILE}-journal").write_bytes(rng.randbytes(rng.choice((0, 100, 5000))))
    else:
        path.unlink()
        path.symlink_to(rng.choice(("/dev/null", "nowhere", str(paths[0]))))


def _schema(results: Path, rng: Random) -> None:
    """Tables that are lost, are others, or are views without end; marks that differ."""
    table = rng.choice(_TABLES)
    statements = rng.choice(
        (
            (f"DROP TABLE {table}",),
            (f"ALTER TABLE {table} RENAME TO other",),
            (f"ALTER TABLE {table} ADD COLUMN more TEXT",),
            (f"CREATE TRIGGER odd AFTER INSERT ON {table} BEGIN DELETE FROM trial; END",),
            (
                f"DROP TABLE {table}",
                f"CREATE VIEW {table} AS WITH RECURSIVE n(a) AS (SELECT 1 UNION ALL SELECT a + 1"
                " FROM n) SELECT a AS trial, a AS checksum, a AS body, a AS digest, a AS name,"
                " a AS value FROM n",
            ),
            ("PRAGMA user_version = 99",),
            ("PRAGMA application_id = 1",),
            ("PRAGMA journal_mode = WAL",),
        )
    )
    for statement in statements:
        _sql(results, statement)


def _sql(results: Path, statement: str, *values: Any) -> list[tuple]:
    """Behind the store's back."""
    with closing(sqlite3.connect(results / FILE)) as connection, connection:
        return connection.execute(statement, values).fetchall()


def _picture() -> bytes:
    import numpy as np

    from harness.mitsuba_runtime import exr, variant

    variant.use("cpu")
    return exr.encoded(np.full((4, 4, 3), 0.5))
