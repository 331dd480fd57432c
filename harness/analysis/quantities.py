"""Quantities that are made of several recorded ones."""

from __future__ import annotations

from harness.analysis.combine import Estimate
from harness.analysis.results import Results


def scaled(estimate: Estimate, factor: float) -> Estimate:
    """Another unit: all three numbers times ``factor`` > 0."""
    if not estimate.has_interval:
        return Estimate(factor * estimate.value, note=estimate.note)
    low, high = factor * estimate.low, factor * estimate.high
    return Estimate(factor * estimate.value, low, high, estimate.note)


def nanoseconds_per_sample(
    results: Results, material: str, method: str, scene: str
) -> Estimate | str:
    """Time of one sample of one pixel in a render, or the reason why there is none.

    The interval is that of the seconds per sample per pixel of the whole image; the number of
    pixels is the product of the two recorded rates.
    """
    at = (material, method, scene)
    rate = results.number("equal-time", "samples-per-second", *at)
    per_spp = results.number("equal-time", "seconds-per-spp", *at)
    if isinstance(rate, str) or isinstance(per_spp, str):
        return rate if isinstance(rate, str) else str(per_spp)
    pixels = rate.value * per_spp.value
    return scaled(per_spp, 1e9 / pixels)
