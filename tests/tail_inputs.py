"""Five tails whose variance is known, as the estimates of renders have them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from harness.stats.variance import Deviations, Variance, confirmed, diagnosed, less

RARE, WEIGHT, VISITED = 2e-6, 300.0, 0.01
"""Probability and weight of rare hits, and how often a broad sampler meets them."""
RENDERS, PIXELS, SPP = 6, 2400, 48
"""As the quick profile of suites/table2.yaml has them, of a sphere in 64 x 64 pixels."""

VARIANCES = {
    "normal": 1.0,
    "lognormal-1": math.e * (math.e - 1),
    "lognormal-2": math.exp(4) * (math.exp(4) - 1),
    "pareto-2.2": 2.2 / 0.2 - (2.2 / 1.2) ** 2,
    "rare": 2 * (1 - RARE) + RARE * WEIGHT**2 - (1 + RARE * (WEIGHT - 1)) ** 2,
}


def draw(kind: str, rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray:
    """Estimates of one sample each."""
    if kind == "pareto-2.2":
        return (1 - rng.random(shape)) ** (-1 / 2.2)
    normal = rng.standard_normal(shape, dtype=np.float32)
    if kind.startswith("lognormal"):
        return np.exp(float(kind[-1]) * normal)
    x = 1 + normal
    if kind == "rare":
        x.ravel()[rng.integers(x.size, size=rng.poisson(RARE * x.size))] = WEIGHT
    return x


def renders(kind: str, rng: np.random.Generator, times: float = 1.0) -> Variance:
    """The variance of such renders as the harness has it; all estimates are ``times`` as large.

    Rare hits are what a method samples too rarely: there the second moment by other samples
    takes part, of which half are the method's and half meet the hits one time in a hundred.
    """
    shape = (RENDERS, PIXELS, SPP)
    x = times * draw(kind, rng, shape)
    y = x.var(-1, ddof=1, dtype=float)
    plain = diagnosed(float(y.mean()), Deviations.of(y))
    if kind != "rare":
        return plain
    mean = x.mean(-1, dtype=float)
    square = (np.square(mean.sum(0)) - np.square(mean).sum(0)) / (RENDERS * (RENDERS - 1))
    error = np.square(mean).mean(1).std(ddof=1) / math.sqrt(RENDERS)
    q = (RARE + VISITED) / 2
    usual = np.square(times * (1 + rng.standard_normal(shape, dtype=np.float32)), dtype=float)
    hit = rng.random(shape, dtype=np.float32) < q
    z = np.where(hit, (times * WEIGHT) ** 2 * RARE / q, usual * (1 - RARE) / (1 - q)).mean(-1)
    second = diagnosed(float(z.mean()), Deviations.of(z))
    return confirmed(plain, less(second, float(square.mean()), float(error)))


def conditions(kind: str, rng: np.random.Generator, n: int = 64) -> NDArray:
    """Values [n] of mean one, as divergences over conditions."""
    if kind == "normal":
        return 1 + 0.3 * rng.standard_normal(n)
    if kind == "pareto-2.2":
        return draw(kind, rng, (n,)) * 1.2 / 2.2
    sigma = float(kind[-1])
    return rng.lognormal(-sigma * sigma / 2, sigma, n)
