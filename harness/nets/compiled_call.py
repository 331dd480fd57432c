"""A call of a compiled kernel: the columns that it reads and writes, and the record of its run."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr

from harness.core.columns.bridge import Columns
from harness.core.compiled import history
from harness.core.compiled.library import Library
from harness.core.compiled.memory import addresses, empty


@dataclass(frozen=True)
class Call:
    """``rows`` of ``raw`` to be read and of ``out`` to be written.

    ``inputs`` and ``outputs`` are their addresses; ``wide`` says which inputs have a value a row,
    and not one for all.
    """

    rows: int
    raw: Columns
    out: Columns
    inputs: ctypes.Array
    wide: ctypes.Array
    outputs: ctypes.Array

    @classmethod
    def of(cls, raw: Columns, outputs: int) -> Call:
        """All that it reads is computed before, in one kernel of Dr.Jit's if it can be."""
        rows = max(dr.width(column) for column in raw)
        array = type(raw[-1])
        if rows == 0:
            return cls(0, [], [array() for _ in range(outputs)], *map(_pointers, ([],) * 3))
        # Copies: what a caller holds stays as it is, a literal a literal.
        raw = [array(column) for column in raw]
        out = empty(array, rows, outputs)
        places = addresses([*raw, *out])
        wide = (ctypes.c_uint8 * len(raw))(*(dr.width(column) != 1 for column in raw))
        return cls(
            rows, raw, out, _pointers(places[: len(raw)]), wide, _pointers(places[len(raw) :])
        )

    def run(
        self,
        library: Library,
        what: str,
        work: Callable[..., None],
        again: Callable[..., None] | None = None,
    ) -> Columns:
        """``work(*pool)`` unless there are no rows: :attr:`out`, computed when it returns.

        ``again`` is the networks of it alone, where they are not all.
        """
        if not self.rows:
            return self.out
        pool = ctypes.c_void_p(library.submit), ctypes.c_void_p(library.wait)
        start = time.perf_counter()
        work(*pool)
        if history.wanted():
            seconds = time.perf_counter() - start
            # The work knows this call, so that its columns live while somebody may repeat it.
            alone, more = again or work, again is not None
            history.add(history.Run(what, self.rows, seconds, more, lambda: alone(*pool)))
        return self.out


def _pointers(places: list[int]) -> ctypes.Array:
    return (ctypes.c_void_p * len(places))(*places)
