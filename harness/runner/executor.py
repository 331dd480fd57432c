"""Where tasks are carried out: an executor takes them and gives answers, in whatever order.

A task holds all it needs (:mod:`harness.runner.task`), so that it can go to any process of any
machine that has this package. The driver of the run alone knows what depends on what, and writes.
"""

from __future__ import annotations

from typing import Protocol, Self

from harness.core.protocol.errors import InputError, nearest
from harness.runner.task import Answer, Task

LOCAL, DASK, INLINE = "local", "dask", "inline"
NAMES = (LOCAL, DASK, INLINE)
default = LOCAL
"""What a run takes that names none."""


class Executor(Protocol):
    """Use it as a context manager: what it started ends with it."""

    @property
    def slots(self) -> int:
        """Tasks that it can have in hand at a time, of those that need not be ``alone``."""

    @property
    def timed_slots(self) -> int:
        """Tasks at a time of those that have to be alone: one for each machine."""

    isolated: bool
    """Whether methods that are not ours run in processes of their own."""

    def __enter__(self) -> Self:
        """Nothing is started before it is needed."""

    def __exit__(self, *exception: object) -> None:
        """End all that was started."""

    def submit(self, number: int, task: Task) -> None:
        """Take a task; ``number`` is the caller's."""

    def wait(self) -> list[tuple[int, Answer]]:
        """Answers that are there; none after a while, or if nothing was submitted."""


def check(name: str) -> str:
    """``name``, if there is such an executor."""
    if name not in NAMES:
        raise InputError(f"unknown executor '{name}'{nearest(name, NAMES)}")
    return name


def carry_out(execute: Executor, task: Task) -> Answer:
    """The answer to a single task, while nothing else is in hand."""
    execute.submit(-1, task)
    while True:
        for _, answer in execute.wait():
            return answer
