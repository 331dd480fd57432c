"""One run at a time writes to a results folder, and only to a folder of ours."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from harness.core.protocol.errors import InputError
from harness.store import files
from harness.store.database import ASIDE, FILE, OLD_PLAN, Damaged, connect, is_ours

_LOCK = ".lock"
_HARMLESS = (_LOCK, ".gitignore")
_OURS = (FILE, files.FOLDER, "suite.yaml", "report", *_HARMLESS)


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
        file = os.open(results / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    except OSError as error:
        raise InputError(f"{results}: cannot be written: {error.strerror}") from None
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{results}: another run is writing there; wait for it or choose another --out"
            ) from None
        if not (results / FILE).exists():
            connect(results, write=True).close()  # from now on the folder carries our mark
        yield
    finally:
        os.close(file)


def claim(results: Path) -> None:
    """Make the folder if need be; refuse one that is not ours to write to."""
    if not str(results) or results == Path():
        raise InputError("--out: expected a folder of its own for the results")
    if results.exists() and not results.is_dir():
        raise InputError(f"{results}: is a file; expected a folder for the results")
    if (results / FILE).is_file() or (results / OLD_PLAN).is_file():
        with suppress(Damaged):  # which a run sets aside
            connect(results).close()  # says what it is if it is not ours
    if results.is_dir():
        names = sorted(path.name for path in results.iterdir())
        # A file that is damaged beyond recognition is ours if all beside it is.
        ours = _OURS if FILE in names else _HARMLESS
        others = [n for n in names if n not in ours and not n.startswith(f"{FILE}-")]
        others = [n for n in others if not n.startswith(ASIDE)]
        if others and not is_ours(results):
            raise InputError(
                f"{results}: holds other things than results ({', '.join(others[:3])}"
                f"{', ...' if len(others) > 3 else ''}); expected an empty or a new folder"
            )
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{results}: cannot be made: {error.strerror}") from None
