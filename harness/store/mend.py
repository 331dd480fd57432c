"""Sets aside what is damaged in a results folder, so that it is measured again."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from harness.store.database import FILE, Damaged, connect
from harness.store.folder import ResultsFolder


def mend(folder: Path, say: Callable[[str], None]) -> None:
    """Check all that is stored; call it with the folder locked.

    A trial that does not match its checksums, or one of whose arrays or files does not, leaves the
    results and is kept apart in the table ``damaged``. A file that is no whole database any more
    is renamed, and what can be read of it is taken over.
    """
    try:
        _whole(folder)
    except Damaged:
        aside = _rebuild(folder)
        say(f"{folder / FILE}: was damaged; kept as {aside.name}, what can be read is taken over")
    with ResultsFolder(folder, write=True) as results:
        for trial, reason in results.damage().items():
            results.set_aside(trial, reason)
            say(f"{folder}: set aside and to be measured again: {reason}")


def _whole(folder: Path) -> None:
    with ResultsFolder(folder, write=True) as results:
        results.check()


def _rebuild(folder: Path) -> Path:
    """A new database of the readable rows of a damaged one, which is renamed."""
    path = folder / FILE
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    aside = folder / f"{FILE}.damaged-{stamp}"
    os.replace(path, aside)
    connect(folder, write=True).close()
    old, new = sqlite3.connect(aside), sqlite3.connect(path)
    try:
        tables = [n for (n,) in new.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in tables:
            for row in _readable(old, table):
                marks = ", ".join("?" * len(row))
                new.execute(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", row)
        new.commit()
    finally:
        old.close()
        new.close()
    return aside


def _readable(old: sqlite3.Connection, table: str) -> list[tuple]:
    """Rows of a table up to the damage, from both ends."""
    found: dict[tuple, None] = {}
    for order in ("ASC", "DESC"):
        try:
            for row in old.execute(f"SELECT * FROM {table} ORDER BY 1 {order}"):
                found[row] = None
        except sqlite3.DatabaseError:
            continue
    return list(found)
