"""Which trials a store holds, in one number, so that a row which is lost is noticed.

A page of the database that is damaged takes its rows with it, and the database may not say so. The
number is the exclusive or of a hash of every key with its checksum: each row that comes or goes
changes it, and the order does not matter.
"""

from __future__ import annotations

import hashlib
import sqlite3

_NAME = "census"
_HEX = 32


def changed(connection: sqlite3.Connection, key: str, checksum: str | None) -> None:
    """Note, inside a transaction and before it is done, that a trial gets this checksum.

    None: that it goes.
    """
    found = _stored(connection)
    number = _counted(connection) if found is None else found
    row = connection.execute("SELECT checksum FROM trial WHERE trial = ?", (key,)).fetchone()
    if row is not None:
        number ^= _of(key, row[0])
    if checksum is not None:
        number ^= _of(key, checksum)
    _keep(connection, number)


def begin_anew(connection: sqlite3.Connection) -> None:
    """Inside a transaction: from now on, what is there is what there is to be."""
    _keep(connection, _counted(connection))


def fits(connection: sqlite3.Connection) -> bool:
    """Whether all trials that were stored are there and no others; a store without one fits."""
    found = _stored(connection)
    return found is None or found == _counted(connection)


def _keep(connection: sqlite3.Connection, number: int) -> None:
    connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (_NAME, f"{number:0{_HEX}x}"))


def _stored(connection: sqlite3.Connection) -> int | None:
    row = connection.execute("SELECT value FROM meta WHERE name = ?", (_NAME,)).fetchone()
    if row is None:
        return None
    try:
        return int(row[0], 16)
    except (ValueError, TypeError):
        return -1  # damaged: no number of trials


def _counted(connection: sqlite3.Connection) -> int:
    number = 0
    for key, checksum in connection.execute("SELECT trial, checksum FROM trial"):
        number ^= _of(key, checksum)
    return number


def _of(key: object, checksum: object) -> int:
    return int(
        hashlib.sha256(f"{key} {checksum}".encode("utf-8", "replace")).hexdigest()[:_HEX], 16
    )
