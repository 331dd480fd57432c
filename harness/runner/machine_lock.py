"""Whose turn it is: one timing at a time per machine and user, and nothing of ours beside it."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


@contextmanager
def turn(note: Callable[[str], None], alone: bool = True) -> Iterator[None]:
    """Work inside when it is one's turn, whatever the results folder; a killed run leaves no lock.

    Work that is timed is ``alone``; other work goes on together with its like. Who waits keeps
    the door, so that untimed work which keeps coming cannot keep a timing out for ever.
    """
    with _opened("door") as door, _opened("timing") as room:
        _lock(door, fcntl.LOCK_EX, note)
        _lock(room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH, note)
        fcntl.flock(door, fcntl.LOCK_UN)
        yield


def _opened(name: str) -> IO[str]:
    return (Path(tempfile.gettempdir()) / f"harness-{name}-{os.getuid()}.lock").open("w")


def _lock(file: IO[str], mode: int, note: Callable[[str], None]) -> None:
    try:
        fcntl.flock(file, mode | fcntl.LOCK_NB)
    except BlockingIOError:
        note("waiting: other work of ours runs on this machine")
        fcntl.flock(file, mode)
