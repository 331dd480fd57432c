"""What the C library does with memory that was freed: kept for the next call, or given back.

The buffers of a batch are some megabytes each. By default glibc hands such memory back when it is
freed, and the next call takes every page of it anew from the system: thousands of page faults,
a third to a half of the time of a small network. Renderers keep their memory.
"""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # mallopt(3)
_NEVER = -1
_MAPPED = 1 << 29
"""Bytes. What is larger, as the queries of a whole training, still goes back when it is freed."""


def keep() -> bool:
    """From now on, freed memory stays with this process; whether the C library can do that."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    return bool(mallopt(_MMAP_THRESHOLD, _MAPPED)) and bool(mallopt(_TRIM_THRESHOLD, _NEVER))


def give_back() -> None:
    """What is free in this process now, to the system; where it knows how."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
