"""The file ``results.sqlite`` of a results folder: its tables, how it is opened, what can go wrong.

Published results have the same tables, in a file that is compressed as a whole
(:mod:`harness.store.whole`).

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
from harness.store import whole

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


def file_of(folder: Path) -> Path | None:
    """The file that holds the folder's results; None where there are none of this format."""
    for name in (FILE, whole.WHOLE):
        if (folder / name).is_file():
            return folder / name
    return None


def folders_in(place: Path) -> list[Path]:
    """The folders directly below ``place`` that hold results, by name."""
    return sorted({path.parent for name in (FILE, whole.WHOLE) for path in place.glob(f"*/{name}")})


def is_ours(folder: Path) -> bool:
    """Whether the folder holds results of this format (a marked file, of any version)."""
    if file_of(folder) == folder / whole.WHOLE:
        return whole.is_whole(folder / whole.WHOLE)
    try:
        with (folder / FILE).open("rb") as file:
            head = file.read(100)
    except OSError:
        return False
    return head[:16] == b"SQLite format 3\0" and int.from_bytes(head[68:72], "big") == MARK


def connect(folder: Path, write: bool = False, look: bool = True) -> sqlite3.Connection:
    """The open file of a results folder; with ``write`` it is made if it is not there.

    One that is compressed as a whole is opened in memory, or made plain to be written to.

    Without ``look`` it is not looked at: for a reader of one of many arrays, in a folder that was.

    Raises:
        InputError: no results there, an older or newer format, not readable, not a database.
    """
    path = folder / FILE
    if not path.is_file() and (folder / whole.WHOLE).is_file():
        connection = _opened_whole(folder / whole.WHOLE, path if write else None)
        if connection is not None:
            return _prepared(connection, folder, look)
    elif not path.is_file():
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
    return _prepared(connection, folder, look, write)


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """The open file, for one of many looks into a folder that was looked at before.

    Raises:
        InputError: as :func:`connect`.
    """
    if file_of(folder) == folder / whole.WHOLE:
        with _explained_whole(folder / whole.WHOLE):
            connection = whole.kept(folder / whole.WHOLE)
        yield connection
        return
    with closing(connect(folder, look=False)) as connection:
        yield connection


def _opened_whole(path: Path, plain: Path | None) -> sqlite3.Connection | None:
    """Open in memory, or made ``plain``."""
    with _explained_whole(path):
        if plain is None:
            return whole.opened(path)
        whole.restore(path, plain)
        return None


@contextmanager
def _explained_whole(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (ValueError, sqlite3.Error) as error:
        raise Damaged(
            f"{path}: is damaged ({error}); take it anew from where it was published, or remove it"
            " to measure all of it again"
        ) from None


def _prepared(
    connection: sqlite3.Connection, folder: Path, look: bool, write: bool = False
) -> sqlite3.Connection:
    # A text that is damaged is another text, which its checksum tells.
    connection.text_factory = lambda text: text.decode("utf-8", "replace")
    try:
        with explained(folder):
            if not write:
                connection.execute("PRAGMA query_only = ON")
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
            if look:
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
            make_tables(connection)
        return
    if mark == 0 and tables == 0:
        raise Damaged(f"{_named(folder)}: is empty; harness run begins it anew")
    if mark != MARK:
        raise InputError(f"{_named(folder)}: is another program's database; choose another folder")
    if version == FORMAT and _made(connection) != _MADE:
        raise Damaged(f"{_named(folder)}: is damaged: its tables are not those of this format")
    if version != FORMAT:
        which = "an older" if version < FORMAT else "a newer"
        raise InputError(
            f"{_named(folder)}: results of {which} format ({version}; this version writes"
            f" {FORMAT}); run the suite again with another --out"
        )


def make_tables(connection: sqlite3.Connection) -> None:
    """Make an empty database one of ours, inside a transaction."""
    for statement in _TABLES.split(";"):
        if statement.strip():
            connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {MARK}")
    connection.execute(f"PRAGMA user_version = {FORMAT}")


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
        raise InputError(f"{_named(folder)}: {_sentence(str(error))}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        # The latter: SQLite's own message names a table by bytes that are no text.
        raise Damaged(
            f"{_named(folder)}: is damaged ({error}); harness run sets it aside, keeps what can be"
            " read and measures the rest again"
        ) from error


def _named(folder: Path) -> Path:
    return file_of(folder) or folder / FILE


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
