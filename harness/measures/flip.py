"""NVIDIA's FLIP between two renders, at exposures that stay the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.disk import REC709

STOPS = 2.0
"""Exposures are one that brings the reference's bright parts to white, and so many stops up."""


def exposures(reference: NDArray) -> dict[str, float | int]:
    """FLIP's parameters for all comparisons with ``reference`` [H, W, 3].

    FLIP would choose them for each pair anew, and its numbers would not compare.
    """
    bright = float(np.quantile(reference @ np.array(REC709), 0.99))
    start = float(np.log2(1 / bright)) if bright > 0 else 0.0
    return {"startExposure": start, "stopExposure": start + STOPS, "numExposures": 3}


def flip(
    image: NDArray, reference: NDArray, parameters: dict[str, float | int]
) -> tuple[float, NDArray]:
    """Mean and map [H, W] of HDR-FLIP, between 0 and 1."""
    import flip_evaluator

    # A measured material may send back less than nothing, and FLIP has no such light.
    a, b = (np.maximum(x, 0).astype(np.float32) for x in (reference, image))
    found, mean, _ = flip_evaluator.evaluate(
        np.ascontiguousarray(a),
        np.ascontiguousarray(b),
        "HDR",
        applyMagma=False,
        parameters=dict(parameters),
    )
    return float(mean), np.asarray(found)[..., 0]
