"""The variance of one sample of a pixel in constant light, from integrals at its points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from harness.stats.intervals import Interval
from harness.stats.log_interval import Z95, LogInterval
from harness.stats.variance import RESOLVED, Deviations, Variance, diagnosed


@dataclass(frozen=True)
class Integral:
    """``total`` variance, averaged over pixels; ``footprint``, the part of every sampler."""

    total: Variance
    footprint: Interval
    points: NDArray
    """The same at both points of every pixel [2, P]."""


def variance_of(arrays: Mapping[str, NDArray]) -> Integral:
    """Of the arrays of :class:`harness.measures.constant_light.ConstantLight`.

    The part of the sampler has the interval of two points in each pixel, with the tail of
    their differences; that of the footprint, half the squared difference of two albedos, the
    normal one over pixels; it may come out a little below zero.
    """
    scale = float(arrays["radiance"]) ** 2
    sampler = scale * np.asarray(arrays["sampler"], float)
    albedo = np.asarray(arrays["albedo"], float)
    # Of differences by two sets of directions: no noise is squared.
    off = albedo[0] - albedo[1]
    halves = scale * off[0] * off[1] / 2
    error = float(halves.std(ddof=1) / math.sqrt(len(halves)))
    mean = float(halves.mean())
    footprint = Interval(mean, mean - Z95 * error, mean + Z95 * error)
    points = sampler + halves
    found = diagnosed(float(sampler.mean()), Deviations.of(sampler))
    value = found.value + mean
    if found.log is None:
        if not value > 0:
            return Integral(replace(found, value=value), footprint, points)
        # An exact sampler: what is left is the footprint's alone.
        half = Z95 * math.hypot(error, Deviations.of(sampler).error)
        if not value > half:
            return Integral(replace(found, value=value), footprint, points)
        log = LogInterval.between(value, value - half, value + half)
        return Integral(Variance(value, log, "light"), footprint, points)
    _, low, high = found.log.interval
    low = value - math.hypot(found.value - low, Z95 * error)
    high = value + math.hypot(high - found.value, Z95 * error)
    if found.tail not in RESOLVED:
        high = math.inf
    log = LogInterval.between(value, max(low, 0.0), high)
    return Integral(replace(found, value=value, log=log), footprint, points)
