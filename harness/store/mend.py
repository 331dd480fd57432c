"""Sets aside what is damaged in a results folder, so that it is measured again."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from harness.core.protocol.errors import InputError
from harness.store.damage import damage
from harness.store.database import ASIDE, FILE, Damaged, connect, explained, file_of
from harness.store.folder import ResultsFolder

_JOURNAL = f"{FILE}-journal"


def mend(folder: Path, say: Callable[[str], None]) -> None:
    """Check all that is stored; call it with the folder locked.

    A trial that does not match its checksums, or one of whose arrays or files does not, leaves the
    results and is kept apart in the table ``damaged``. A file that is no whole database any more
    is renamed, and what can be read of it is taken over.

    Raises:
        InputError: the folder cannot be written.
    """
    if (file_of(folder) or folder / FILE).stat().st_size == 0:
        say(f"{folder / FILE}: was empty; begun anew")
    try:
        _whole(folder)
    except Damaged:
        aside = _rebuild(folder)
        say(f"{folder / FILE}: was damaged; kept as {aside.name}, what can be read is taken over")
    with ResultsFolder(folder, write=True) as results:
        lost = results.lost()
        found = damage(results)
        if found:
            results.set_aside(found)
        if lost:
            results.accept()
    if lost:
        say(lost)
    for reason in found.values():
        say(f"set aside and to be measured again: {reason}")


def _whole(folder: Path) -> None:
    with ResultsFolder(folder, write=True) as results:
        results.check()


def _rebuild(folder: Path) -> Path:
    """A new database of the readable rows of a damaged one, which is renamed."""
    path = folder / FILE
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")
    aside = folder / f"{ASIDE}{stamp}"
    try:
        made = Path(tempfile.mkdtemp(prefix=f"{ASIDE}new-", dir=folder))
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        with explained(folder):
            connect(made, write=True).close()
            with (
                closing(sqlite3.connect(path)) as old,
                closing(sqlite3.connect(made / FILE)) as new,
            ):
                _take_over(old, new)
        os.replace(path, aside)
        if (folder / _JOURNAL).exists():  # it belongs to the damaged file
            os.replace(folder / _JOURNAL, f"{aside}-journal")
        os.replace(made / FILE, path)
    finally:
        shutil.rmtree(made, ignore_errors=True)
    return aside


def _take_over(old: sqlite3.Connection, new: sqlite3.Connection) -> None:
    tables = [n for (n,) in new.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    for table in tables:
        for row in _readable(old, table):
            marks = ", ".join("?" * len(row))
            try:
                new.execute(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", row)
            except (sqlite3.ProgrammingError, sqlite3.DataError, sqlite3.OperationalError) as error:
                if "full" in str(error) or "disk I/O" in str(error):
                    raise
                continue  # a value that no text or number can be made of, a column too many
    new.commit()


def _readable(old: sqlite3.Connection, table: str) -> list[tuple]:
    """Rows of a table up to the damage, from both ends."""
    found: dict[tuple, None] = {}
    # In the order of the pages one that is damaged costs its own rows; a table without rowids
    # has the order of its key.
    kinds = "SELECT 1 FROM sqlite_master WHERE name = ? AND type = 'table'"
    try:  # not a view, which may be without end
        if old.execute(kinds, (table,)).fetchone() is None:
            return []
    except sqlite3.DatabaseError:
        return []
    for order in ("rowid ASC", "rowid DESC", "1 ASC", "1 DESC"):
        try:
            for row in old.execute(f"SELECT * FROM {table} ORDER BY {order}"):
                found[row] = None
        except sqlite3.DatabaseError:
            continue
    return list(found)
