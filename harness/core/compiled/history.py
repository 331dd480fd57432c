"""What the compiled kernels were asked to run, for whoever wants to know."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

_open: list[list[Run]] = []


@dataclass(frozen=True)
class Run:
    """One run: what it was in words, its rows and seconds; ``again`` has the network alone run.

    ``more`` says whether the network was not all of it.
    """

    what: str
    rows: int
    seconds: float
    more: bool
    again: Callable[[], None]


def wanted() -> bool:
    """Whether anybody records."""
    return bool(_open)


def add(run: Run) -> None:
    """To every record that is open."""
    for runs in _open:
        runs.append(run)


@contextlib.contextmanager
def recorded() -> Iterator[list[Run]]:
    """The runs of the block, in order."""
    runs: list[Run] = []
    _open.append(runs)
    try:
        yield runs
    finally:
        # By identity: equal lists are not the same one.
        del _open[next(i for i, other in enumerate(_open) if other is runs)]
