"""Stored renders: the best picture there is of a material, and how to show one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.analysis.bias import bias_warnings
from harness.analysis.results import Results

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def reference(results: Results, material: str, scene: str) -> NDArray | None:
    """Mean [H, W, 3] of the methods' long renders at equal samples, weighted by 1/variance; biased
    methods are left out."""
    biased = bias_warnings(results)
    total, weights = None, 0.0
    for method in results.methods:
        variance = results.number("equal-spp", "variance", material, method.label, scene)
        for trial in results.trials("equal-spp", material, method.label, scene):
            image = results.stored(trial).images.get("mean")
            if image is None or isinstance(variance, str) or not variance.value > 0:
                continue
            if biased(material, method.label, scene):
                continue
            spp = results.number("equal-spp", "spp", material, method.label, scene)
            weight = (1.0 if isinstance(spp, str) else spp.value) / variance.value
            share = image.astype(np.float64) * weight
            total = share if total is None else total + share
            weights += weight
    return None if total is None else total / weights


def exposure(image: NDArray) -> float:
    """Factor that brings the 99% quantile of luminance to white."""
    bright = float(np.quantile(image @ LUMINANCE, 0.99))
    return 1.0 / bright if bright > 0 else 1.0


def srgb(linear: NDArray, scale: float) -> NDArray:
    """Display values in [0, 1]; what is brighter than white is shown white."""
    x = np.clip(linear * scale, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
