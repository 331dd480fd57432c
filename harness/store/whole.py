"""``results.sqlite.xz``: a database compressed as a whole, as published results are kept.

In one piece, what stands elsewhere in it already takes hardly any room: most of what describes
trials and the code that they were measured with. It is read in memory; ``xz -d`` makes the plain
file of it.
"""

from __future__ import annotations

import lzma
import os
import sqlite3
from functools import lru_cache
from pathlib import Path

from harness.store import files

WHOLE = "results.sqlite.xz"
_BEGIN = b"\xfd7zXZ\0"
_LOOKBACK = 2**26
"""Bytes that the packer looks back: more than any published database has."""
_MEMORY = 2**28
"""Bytes that unpacking may take besides what it gives."""
_MOST = 2**29
"""Bytes of a database: what is larger was not written here, or is damaged."""


def is_whole(path: Path) -> bool:
    """Whether the file begins as one."""
    try:
        with path.open("rb") as file:
            return file.read(len(_BEGIN)) == _BEGIN
    except OSError:
        return False


def write(connection: sqlite3.Connection, path: Path) -> None:
    """Put the database there, whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    data = connection.serialize()
    found = {
        "id": lzma.FILTER_LZMA2,
        "preset": 9 | lzma.PRESET_EXTREME,
        "dict_size": min(_LOOKBACK, max(2**16, len(data))),
    }
    files.put(path, lzma.compress(data, check=lzma.CHECK_SHA256, filters=[found]))


def opened(path: Path) -> sqlite3.Connection:
    """The database, in memory: what is written there is lost.

    Raises:
        ValueError: it is not what was written.
        OSError: it cannot be read.
    """
    connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    connection.deserialize(_plain(path, _version(path)))
    return connection


def kept(path: Path) -> sqlite3.Connection:
    """As :func:`opened`, of a file that many look into: the same connection until it changes.

    It is not to be closed.
    """
    return _kept(path, _version(path))


def restore(path: Path, target: Path) -> None:
    """Make the plain database of it, and remove it.

    Raises:
        ValueError, OSError: as :func:`opened`.
    """
    files.put(target, _plain(path, _version(path)))
    path.unlink()


def _version(path: Path) -> tuple[int, int, int]:
    found = os.stat(path)
    return found.st_ino, found.st_mtime_ns, found.st_size


@lru_cache(maxsize=2)
def _plain(path: Path, version: tuple[int, int, int]) -> bytes:
    packed = path.read_bytes()
    unpacker = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
    try:
        data = unpacker.decompress(packed, _MOST)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(str(error)) from None
    if not unpacker.eof or unpacker.unused_data:
        larger = len(data) >= _MOST
        raise ValueError(f"more than {_MOST:,} bytes" if larger else "cut off, or something added")
    return data


@lru_cache(maxsize=2)
def _kept(path: Path, version: tuple[int, int, int]) -> sqlite3.Connection:
    return opened(path)
