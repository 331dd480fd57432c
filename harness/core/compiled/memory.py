"""Where the numbers of Dr.Jit's arrays lie, for code that reads and writes them in place."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import drjit as dr

from harness.core.columns.bridge import Columns, Float

_DATA, _RELEASE = "_Z12jit_var_datajPPv", "_Z20jit_var_dec_ref_implj"
"""``jit_var_data`` and ``jit_var_dec_ref`` of drjit-core, as compilers spell them in C++."""


def addresses(columns: Sequence[Float]) -> list[int]:
    """Of the first number of each array; all of them computed when it returns.

    Valid while the arrays live.
    """
    dr.make_opaque(columns)
    dr.sync_thread()
    found = _address()
    return [found(column) for column in columns]


def empty(array: type[Float], rows: int, count: int) -> Columns:
    """``count`` arrays of ``rows`` numbers that are yet to be written."""
    made = [dr.empty(array, rows) for _ in range(count)]
    dr.make_opaque(made)
    return made


@lru_cache(maxsize=1)
def _address() -> Callable[[Float], int]:
    """By Dr.Jit's own function, two microseconds; by torch, eleven, should that be missing."""
    try:
        core = ctypes.CDLL(str(next(Path(dr.__file__).parent.glob("libdrjit-core.*"))))
        data, release = getattr(core, _DATA), getattr(core, _RELEASE)
    except (StopIteration, OSError, AttributeError):
        return lambda column: column.torch().data_ptr()
    data.restype, data.argtypes = ctypes.c_uint32, [ctypes.c_uint32, ctypes.c_void_p]
    release.restype, release.argtypes = None, [ctypes.c_uint32]
    place = ctypes.c_void_p()

    def of(column: Float) -> int:
        # The reference is one more to a variable that the caller holds already.
        release(data(column.index, ctypes.byref(place)))
        return place.value or 0

    return of
