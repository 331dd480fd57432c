"""Images as OpenEXR in half precision, through Mitsuba's bitmaps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def encoded(image: np.ndarray) -> bytes:
    """The file of ``image`` [H, W, 3] (or [H, W]), linear, as 16-bit floats."""
    core = _core()
    data = np.ascontiguousarray(image, dtype=np.float32)
    stream = core.MemoryStream()
    half = core.Bitmap(data).convert(component_format=core.Struct.Type.Float16)
    half.write(stream, core.Bitmap.FileFormat.OpenEXR)
    return stream.raw_buffer()


def read(path: Path) -> np.ndarray:
    """An image as float32 [H, W, 3] (or [H, W, 1])."""
    return np.array(_core().Bitmap(str(path))).astype(np.float32)


def _core() -> Any:
    """The part of Mitsuba that all variants share.

    Bitmaps do not depend on the variant; to choose one here would decide for the renders
    that may follow in the same process.
    """
    import drjit
    import mitsuba

    if drjit.thread_count() < 2:
        # OpenEXR waits for Dr.Jit's workers. On one processor there is none: the caller counts as
        # the first thread.
        drjit.set_thread_count(2)
    return mitsuba.mitsuba_ext
