"""One run at a time writes to a results folder, and only to a folder of ours."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from harness.core.protocol.errors import InputError
from harness.store.database import FILE, OLD_PLAN, Damaged, connect, file_of, is_ours

LOCK = ".lock"
_MARK = b"a results folder of the sampling benchmark\n"
"""In the lock: by it a folder is ours whose database is damaged beyond recognition."""
_HARMLESS = (LOCK, ".gitignore")


@contextmanager
def locked(results: Path) -> Iterator[None]:
    """Hold the folder for writing; a killed run leaves no lock.

    The folder is made if it is not there. One that holds something else than results is refused,
    so that a mistyped path costs nobody a file.

    Raises:
        InputError: not a folder, another's folder, not writable, or another run holds it.
    """
    claim(results)
    try:
        # No link is followed and nothing is truncated: the name may be another's.
        file = os.open(results / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise InputError(f"{results}: cannot be written: {error.strerror}") from None
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{results}: another run is writing there; wait for it or choose another --out"
            ) from None
        _mark(file, results)
        if file_of(results) is None:
            connect(results, write=True).close()
        yield
    finally:
        os.close(file)


def claim(results: Path) -> None:
    """Make the folder if need be; refuse one that is not ours to write to."""
    if not str(results) or results == Path():
        raise InputError("--out: expected a folder of its own for the results")
    if results.exists() and not results.is_dir():
        raise InputError(f"{results}: is a file; expected a folder for the results")
    if file_of(results) is not None or (results / OLD_PLAN).is_file():
        with suppress(Damaged):  # which a run sets aside
            connect(results).close()  # says what it is if it is not ours
    if results.is_dir() and not (is_ours(results) or _is_marked(results)):
        others = sorted(path.name for path in results.iterdir() if not _is_begun(path))
        if others:
            raise InputError(
                f"{results}: holds other things than results ({', '.join(others[:3])}"
                f"{', ...' if len(others) > 3 else ''}); expected an empty or a new folder"
            )
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{results}: cannot be made: {error.strerror}") from None


def _mark(file: int, results: Path) -> None:
    try:
        if os.pread(file, 1, 0) == b"":
            os.pwrite(file, _MARK, 0)
    except OSError as error:
        raise InputError(f"{results}: cannot be written: {error.strerror}") from None


def _is_marked(results: Path) -> bool:
    try:
        with (results / LOCK).open("rb") as file:
            return file.read(len(_MARK)) == _MARK
    except OSError:
        return False


def _is_begun(path: Path) -> bool:
    """Whether it is no more than what a run leaves that was killed as it began."""
    if path.name == FILE or path.name.startswith(f"{FILE}-"):
        return path.is_file() and path.stat().st_size == 0
    return path.name in _HARMLESS
