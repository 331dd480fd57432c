"""Images as OpenEXR in half precision, through Mitsuba's bitmaps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


def encoded(image: np.ndarray) -> bytes:
    """The file of ``image`` [H, W, 3] (or [H, W]), linear, as 16-bit floats."""
    core = _core()
    data = np.ascontiguousarray(image, dtype=np.float32)
    stream = core.MemoryStream()
    half = core.Bitmap(data).convert(component_format=core.Struct.Type.Float16)
    with _worker():
        half.write(stream, core.Bitmap.FileFormat.OpenEXR)
    return stream.raw_buffer()


def read(path: Path) -> np.ndarray:
    """An image as float32 [H, W, 3] (or [H, W, 1])."""
    with _worker():
        return np.array(_core().Bitmap(str(path))).astype(np.float32)


@contextmanager
def _worker() -> Iterator[None]:
    """A thread for OpenEXR's tasks, which wait for one of Dr.Jit's pool for ever.

    In a process that may use one core alone the pool has none but the caller's.
    """
    import drjit as dr

    known = dr.thread_count()
    if known < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if known < 2:
            dr.set_thread_count(known)


def _core() -> Any:
    """The part of Mitsuba that all variants share.

    Bitmaps do not depend on the variant; to choose one here would decide for the renders
    that may follow in the same process.
    """
    import mitsuba

    return mitsuba.mitsuba_ext
