"""One timing at a time per machine and user, and nothing of ours beside it."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from harness.core.protocol.errors import InputError


@contextmanager
def machine(note: Callable[[str], None], alone: bool = True) -> Iterator[None]:
    """Work inside while this process holds the machine; a killed run leaves no lock.

    Work that is timed holds it ``alone``; other work shares it with its like. Who waits holds the
    queue, so that untimed work which keeps coming cannot keep a timing out for ever.
    """
    with _opened("queue") as queue, _opened("machine") as held:
        _lock(queue, fcntl.LOCK_EX, note)
        _lock(held, fcntl.LOCK_EX if alone else fcntl.LOCK_SH, note)
        fcntl.flock(queue, fcntl.LOCK_UN)
        try:
            yield
        finally:
            # Closing would not do: a process that was forked inside has the file open, too.
            fcntl.flock(held, fcntl.LOCK_UN)


@contextmanager
def _opened(name: str) -> Iterator[int]:
    path = Path(tempfile.gettempdir()) / f"harness-{name}-{os.getuid()}.lock"
    try:
        # No link is followed and nothing is truncated: the folder is everybody's.
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise InputError(
            f"{path}: the lock of timings cannot be opened: {error.strerror}"
        ) from None
    try:
        yield file
    finally:
        os.close(file)


def _lock(file: int, mode: int, note: Callable[[str], None]) -> None:
    try:
        fcntl.flock(file, mode | fcntl.LOCK_NB)
    except BlockingIOError:
        note("waiting: other work of ours runs on this machine")
        fcntl.flock(file, mode)
