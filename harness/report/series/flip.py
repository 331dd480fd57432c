"""NVIDIA's FLIP of a render against its reference, as the measures take it, without PyTorch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.report.figures.rendered import exposure

STOPS = 2.0
"""Exposures are the one that brings the reference's bright parts to white, and up to so many
stops above."""


def flip(image: NDArray, reference: NDArray) -> tuple[float, NDArray]:
    """Mean and map [H, W] of HDR-FLIP, between 0 and 1, at exposures of the reference alone."""
    import flip_evaluator

    start = float(np.log2(exposure(reference)))
    # A measured material may send back less than nothing, and FLIP has no such light.
    right, found = (np.ascontiguousarray(np.maximum(x, 0), np.float32) for x in (reference, image))
    shown, mean, _ = flip_evaluator.evaluate(
        right,
        found,
        "HDR",
        applyMagma=False,
        parameters={"startExposure": start, "stopExposure": start + STOPS, "numExposures": 3},
    )
    return float(mean), np.asarray(shown)[..., 0]
