"""Raw arrays in the database: the same content once, named by its digest."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from harness.core.protocol.errors import InputError
from harness.store.packing import array_bytes, array_of, digest, pack, unpack

if TYPE_CHECKING:
    import numpy as np


def keep(connection: sqlite3.Connection, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Store arrays, inside a transaction; their digests by name."""
    digests = {}
    for name, array in arrays.items():
        data = array_bytes(array)
        digests[name] = digest(data)
        # What stands there under this digest may be damaged.
        row = (digests[name], pack(data))
        connection.execute("INSERT OR REPLACE INTO blob VALUES (?, ?)", row)
    return digests


def read(
    connection: sqlite3.Connection, folder: Path, key: str, kept: Mapping[str, str]
) -> dict[str, np.ndarray]:
    """Arrays by their digests ``kept``; ``key`` says whose they are.

    Raises:
        InputError: one does not match its checksum.
    """
    found = {}
    for name, wanted in kept.items():
        data = _intact(connection, folder, key, name, wanted)
        try:
            found[name] = array_of(data)
        except ValueError as error:
            raise InputError(
                f"{folder}: the stored array '{name}' of trial {key}: {error}"
            ) from None
    return found


def names_of(text: object) -> dict[str, str]:
    """Digests by name, as :mod:`harness.store.code` keeps those of a probe.

    Of a text that is damaged one that nothing has, so that it is found to be.
    """
    try:
        found = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        found = None
    if isinstance(found, dict) and all(isinstance(kept, str) for kept in found.values()):
        return found
    return {"(its names)": ""}


def damage(
    connection: sqlite3.Connection, folder: Path, named: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """What is wrong with arrays, by the keys whose digests by name are ``named``."""
    found: dict[str, str] = {}
    users: dict[str, list[tuple[str, str]]] = {}
    for key, kept in named.items():
        for name, wanted in kept.items():
            users.setdefault(wanted, []).append((key, name))
    for wanted, using in users.items():
        keys = [key for key, _ in using]
        try:
            _intact(connection, folder, ",".join(keys), using[0][1], wanted)
        except InputError as error:
            found.update(dict.fromkeys(keys, str(error)))
    return found


def sweep(connection: sqlite3.Connection, named: Mapping[str, Mapping[str, str]]) -> None:
    """Remove arrays, inside a transaction, that no key names."""
    wanted = {kept for arrays in named.values() for kept in arrays.values()}
    for (kept,) in connection.execute("SELECT digest FROM blob").fetchall():
        if kept not in wanted:
            connection.execute("DELETE FROM blob WHERE digest = ?", (kept,))


def _intact(
    connection: sqlite3.Connection, folder: Path, key: str, name: str, wanted: str
) -> bytes:
    row = connection.execute("SELECT body FROM blob WHERE digest = ?", (wanted,)).fetchone()
    try:
        data = unpack(row[0]) if row else b""
    except (ValueError, TypeError):
        data = b""
    if digest(data) != wanted:
        raise InputError(
            f"{folder}: the stored array '{name}' of trial {key} is damaged;"
            " harness run measures it again"
        )
    return data
