"""Counts of what was run, for whoever asks: no more than a test of a list while nobody does.

Code whose runs are worth counting says so where it runs::

    counting.add("network", rows)

and one who wants to know opens a counter around the work::

    with counting.into(Counter()) as counts:
        ...
    counts["network"]
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator

_open: list[Counter[str]] = []


def add(what: str, rows: int) -> None:
    """``rows`` more of ``what``, to every counter that is open."""
    for counter in _open:
        counter[what] += rows


def wanted() -> bool:
    """Whether anybody counts; to be asked first where the number of rows is costly to find."""
    return bool(_open)


@contextlib.contextmanager
def into(counter: Counter[str]) -> Iterator[Counter[str]]:
    """``counter``, open while the block runs."""
    _open.append(counter)
    try:
        yield counter
    finally:
        # By identity: equal counters are not the same one.
        del _open[next(i for i, other in enumerate(_open) if other is counter)]
