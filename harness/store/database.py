"""The file ``results.sqlite`` of a results folder: its tables, how it is opened, what can go wrong.

SQLite, for its transactions (a trial is there whole or not at all, whatever kills the run), for one
file instead of thousands, and because every language reads it. The journal is the classic one,
not the write-ahead log: that needs a writable folder even to read.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from harness.core.protocol.errors import InputError

FILE = "results.sqlite"
ASIDE = f"{FILE}.damaged-"
"""Begins the name of a damaged file that was set aside."""
OLD_PLAN = "plan.json"
"""Mark of the format before this one, a folder a trial."""
MARK = 0x42534446
"""SQLite's ``application_id`` of a file of ours."""
FORMAT = 2
"""SQLite's ``user_version``; a change of the tables makes it grow."""
_LONGEST = 2**29
"""Bytes of one value: no more than is stored, and not what a damaged length says."""
_PATIENCE = 10.0
"""Seconds that a reader waits for a writer's transaction, and the other way round."""

# Rows without a rowid are compact where they are short and wasteful where they hold a body.
_TABLES = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value BLOB NOT NULL);
CREATE TABLE text (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE trial (
    trial TEXT PRIMARY KEY, checksum TEXT NOT NULL, body BLOB NOT NULL);
CREATE TABLE blob (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE damaged (
    trial TEXT NOT NULL, noticed TEXT NOT NULL, reason TEXT NOT NULL, body BLOB);
CREATE TABLE units (digest TEXT PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE probe (
    part TEXT NOT NULL, digest TEXT NOT NULL, trial TEXT NOT NULL, state TEXT NOT NULL,
    arrays TEXT NOT NULL, PRIMARY KEY (part, digest)) WITHOUT ROWID;
CREATE TABLE equivalent (
    part TEXT NOT NULL, old TEXT NOT NULL, new TEXT NOT NULL, shared TEXT NOT NULL,
    PRIMARY KEY (part, old, new, shared)) WITHOUT ROWID;
"""


def is_ours(folder: Path) -> bool:
    """Whether the folder holds results of this format (a marked file, of any version)."""
    try:
        with (folder / FILE).open("rb") as file:
            head = file.read(100)
    except OSError:
        return False
    return head[:16] == b"SQLite format 3\0" and int.from_bytes(head[68:72], "big") == MARK


def connect(folder: Path, write: bool = False) -> sqlite3.Connection:
    """The open file of a results folder; with ``write`` it is made if it is not there.

    Raises:
        InputError: no results there, an older or newer format, not readable, not a database.
    """
    path = folder / FILE
    if not path.is_file():
        if (folder / OLD_PLAN).is_file():
            raise InputError(
                f"{folder}: holds results of an older format, one folder a trial; this version"
                f" keeps them in {FILE}: run the suite again with another --out, or move that"
                " folder away first"
            )
        if not write:
            raise InputError(f"{folder}: holds no results (there is no {FILE})")
    with explained(folder):
        if write:
            connection = sqlite3.connect(path, timeout=_PATIENCE, isolation_level=None)
        else:
            # What a killed run left half written is rolled back by the next who opens the file,
            # for which it has to be writable.
            mode = "rw" if os.access(path, os.W_OK) and os.access(folder, os.W_OK) else "ro"
            uri = f"{path.resolve().as_uri()}?mode={mode}"
            connection = sqlite3.connect(uri, timeout=_PATIENCE, isolation_level=None, uri=True)
            connection.execute("PRAGMA query_only = ON")
        # A text that is damaged is another text, which its checksum tells.
        connection.text_factory = lambda text: text.decode("utf-8", "replace")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
        try:
            _check(connection, folder, write)
        except BaseException:
            connection.close()
            raise
    return connection


def _check(connection: sqlite3.Connection, folder: Path, write: bool) -> None:
    (mark,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if mark == 0 and tables == 0 and write:
        with transaction(connection):
            for statement in _TABLES.split(";"):
                if statement.strip():
                    connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {MARK}")
            connection.execute(f"PRAGMA user_version = {FORMAT}")
        return
    if mark == 0 and tables == 0:
        raise Damaged(f"{folder / FILE}: is empty; harness run begins it anew")
    if mark != MARK:
        raise InputError(f"{folder / FILE}: is another program's database; choose another folder")
    if version == FORMAT and _made(connection) != _MADE:
        raise Damaged(f"{folder / FILE}: is damaged: its tables are not those of this format")
    if version != FORMAT:
        which = "an older" if version < FORMAT else "a newer"
        raise InputError(
            f"{folder / FILE}: results of {which} format ({version}; this version writes {FORMAT});"
            " run the suite again with another --out"
        )


def _made(connection: sqlite3.Connection) -> set[tuple[str, ...]]:
    """Type, name and definition of all that is in the database, but indices of its own making."""
    found = connection.execute(
        "SELECT type, name, sql FROM sqlite_master WHERE name NOT LIKE 'sqlite_%'"
    )
    return {(str(kind), str(name), " ".join(str(sql).split())) for kind, name, sql in found}


def _of_this_format() -> set[tuple[str, ...]]:
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(_TABLES)
        return _made(connection)


_MADE = _of_this_format()
"""What a file has: a view or trigger beside it, which another put there, would be run by us."""


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """All of what is inside, or nothing of it."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


class Damaged(InputError):
    """The file is not a whole database any more."""


@contextmanager
def explained(folder: Path) -> Iterator[None]:
    """SQLite's errors inside as an :class:`InputError` of one line."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise InputError(f"{folder / FILE}: {_sentence(str(error))}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        # The latter: SQLite's own message names a table by bytes that are no text.
        raise Damaged(
            f"{folder / FILE}: is damaged ({error}); harness run sets it aside, keeps what can be"
            " read and measures the rest again"
        ) from error


def _sentence(text: str) -> str:
    known = {
        "locked": "another run is writing there; wait for it or choose another --out",
        "readonly": "cannot be written: the file or its folder is read-only",
        "unable to open": "cannot be opened: the folder is read-only or not there",
        "full": "the disk is full; what was stored before is kept, the same command goes on",
        "disk I/O": "the disk is full or refuses; what was stored before is kept, the same command"
        " goes on",
    }
    return next((said for word, said in known.items() if word in text), text)
