"""Raw arrays in as few bytes as their precision needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def single(values: ArrayLike) -> NDArray:
    """``values`` in single precision; in double where that has no room for one of them.

    No number becomes infinite or zero by it: a divergence that is infinite is another finding than
    one that is large.
    """
    exact = np.asarray(values, np.float64)
    with np.errstate(over="ignore", under="ignore"):
        short = exact.astype(np.float32)
    lost = (np.isinf(short) & np.isfinite(exact)) | ((short == 0) & (exact != 0))
    return exact if lost.any() else short
