"""The variance again, from second moments by samples that are not all the method's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from harness.stats.variance import Deviations, Variance, diagnosed, less

Arrays = Mapping[str, NDArray]


def other_variance(arrays: Arrays) -> Variance | None:
    """By samples that are not all the method's (:mod:`harness.rendering.defensive`)."""
    if "other_second" not in arrays:
        return None
    second = float(np.asarray(arrays["other_second"], float).mean())
    found = diagnosed(second, Deviations.unpacked(arrays["other_deviations"]))
    return less(found, float(arrays["squared_mean"]), float(arrays["squared_mean_error"]))
