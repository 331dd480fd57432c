"""Images and states of fitted methods: files beside the database, named by their content."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from harness.core.protocol.errors import InputError

FOLDER = "files"
LENGTH = 32
"""Hex digits of a digest."""
_OURS = re.compile(rf"([0-9a-f]{{{LENGTH}}}|\.tmp-\d+)\.\w+")


class DamagedFile(InputError):
    """A file beside the database is missing, or is not what was stored."""


def keep(results: Path, name: str, data: bytes) -> str:
    """Keep the content of a file under its digest, which is returned.

    ``name`` gives the suffix. The same content is kept once.

    Raises:
        OSError: the folder cannot be written.
    """
    digest = hashlib.sha256(data).hexdigest()[:LENGTH]
    path = place(results, name, digest)
    path.parent.mkdir(parents=True, exist_ok=True)
    put(path, data)
    return digest


def put(path: Path, data: bytes) -> None:
    """Write a file whole or not at all; it is on the disk when this returns."""
    temporary = path.parent / f".tmp-{os.getpid()}{path.suffix}"
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def place(results: Path, name: str, digest: str) -> Path:
    """Where a file is kept."""
    return results / FOLDER / f"{digest}{_suffix(name)}"


@lru_cache(maxsize=256)
def _suffix(name: str) -> str:
    return Path(name).suffix


def checked(results: Path, name: str, digest: str) -> Path:
    """The file, if it is what was stored.

    Raises:
        DamagedFile: it is missing or its content changed.
    """
    path = place(results, name, digest)
    if not os.path.isfile(path):
        raise DamagedFile(f"{path}: is missing; harness run makes it again")
    if digest_of(path) != digest:
        raise DamagedFile(f"{path}: does not match its checksum; harness run makes it again")
    return path


def sweep(results: Path, wanted: Iterable[str]) -> None:
    """Remove files of ours that no trial names: what a killed run left."""
    kept = set(wanted)
    for path in (results / FOLDER).glob("*"):
        if _OURS.fullmatch(path.name) and path.stem not in kept:
            path.unlink()


def digest_of(path: Path) -> str:
    """First 32 hex digits of the SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:LENGTH]
