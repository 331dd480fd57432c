"""The variance of one sample of a pixel in constant light, from integrals over its points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from harness.stats.distributions import t_quantile
from harness.stats.intervals import Interval
from harness.stats.log_interval import Z95
from harness.stats.variance import Deviations, Variance, diagnosed


@dataclass(frozen=True)
class Integral:
    """``total`` variance, averaged over pixels; ``footprint``, the part of every sampler.

    ``points`` [2, G] are means of the total over groups of ``pixels`` [G], by two halves whose
    points and directions are the same for all methods. ``power`` is the mean squared luminance.
    """

    total: Variance
    footprint: Interval
    points: NDArray
    pixels: NDArray
    power: float


def variance_of(arrays: Mapping[str, NDArray]) -> Integral:
    """Of the arrays of :class:`harness.measures.constant_light.ConstantLight`.

    The total has the interval of the pixels' two halves, with the tail of their differences; the
    footprint, whose directions are light-tailed, Student's over the groups' differences. It may
    come out a little below zero.
    """
    scale = float(arrays["radiance"]) ** 2
    if "albedo" in arrays:
        return _of_older(arrays, scale)
    pixels = np.asarray(arrays["pixels"], float)
    weight = pixels / pixels.sum()
    footprint = scale * np.asarray(arrays["footprint"], float)
    points = scale * np.asarray(arrays["sampler"], float) + footprint
    one = Deviations.unpacked(arrays["deviations"])  # for radiance one
    kept = replace(
        one, largest=scale * one.largest, square=scale**2 * one.square, error=scale * one.error
    )
    found = diagnosed(float((points.mean(0) * weight).sum()), kept)
    part = footprint.mean(0)
    value = float((part * weight).sum())
    error = float(np.sqrt((np.square(weight * (footprint[0] - footprint[1]) / 2)).sum()))
    half = float(t_quantile(0.975, len(pixels))) * error
    power = scale * float(arrays["energy"])
    return Integral(found, Interval(value, value - half, value + half), points, pixels, power)


def _of_older(arrays: Mapping[str, NDArray], scale: float) -> Integral:
    """Of a store that has the variance at two points of each pixel [2, P], and albedos."""
    sampler = scale * np.asarray(arrays["sampler"], float)
    albedo = np.asarray(arrays["albedo"], float)
    # Of differences by two sets of directions: no noise is squared.
    off = albedo[0] - albedo[1]
    halves = scale * off[0] * off[1] / 2
    points = sampler + halves
    error = float(halves.std(ddof=1) / math.sqrt(len(halves)))
    mean = float(halves.mean())
    found = diagnosed(float(points.mean()), Deviations.of(points))
    power = scale * float(np.square(albedo.mean((0, 1))).mean())
    footprint = Interval(mean, mean - Z95 * error, mean + Z95 * error)
    return Integral(found, footprint, points, np.ones(points.shape[1]), power)
