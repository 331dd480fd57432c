r"""Spread on several levels: materials, training seeds within them, render noise within those.

A quantity on the log scale, measured on material m with training seed s, is

.. math:: x_{ms} = \mu + M_m + T_{ms} + e_{ms},

and the mean over the seeds of a material already holds the noise of all levels below it. So the
spread of those means is that of the grand mean, whatever its parts are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats.distributions import chi2_isf, t_quantile
from harness.stats.intervals import Interval
from harness.stats.log_estimate import RESAMPLES, Seed

FEWEST_GROUPS = 8
"""Fewest materials to resample; of fewer, the bootstrap covers 97 to 98 % instead of 95 %."""


class Spread(NamedTuple):
    """Standard deviations on the log scale; nan where there is nothing to tell them from."""

    render: float
    training: Interval


def two_level_mean(groups: Sequence[ArrayLike], seed: Seed = 0, level: float = 0.95) -> Interval:
    """Geometric mean over groups (materials) of that over the values [S] in each (seeds).

    The interval says how it would differ with other materials and seeds of the kind: the
    symmetric studentised bootstrap on the log scale, of materials and of seeds within them;
    Student's t for fewer than eight materials, too few to resample; none for one.
    """
    logs = [np.log(_positive(group)) for group in groups]
    if not logs:
        raise ValueError("no values")
    means = np.array([values.mean() for values in logs])
    middle, n = float(means.mean()), len(means)
    if n < 2:
        return Interval(float(np.exp(middle)), float("nan"), float("nan"))
    error = float(means.std(ddof=1) / np.sqrt(n))
    quantile = float(t_quantile((1 + level) / 2, n - 1))
    if n >= FEWEST_GROUPS:
        quantile = _two_level_quantile(logs, middle, np.random.default_rng(seed), level)
    half = quantile * error
    return Interval(*(float(np.exp(middle + d)) for d in (0.0, -half, half)))


def spread_by_level(values: Sequence[ArrayLike], errors: Sequence[ArrayLike]) -> Spread:
    r"""Render and training spread of logarithms ``values`` [S] by material.

    ``errors`` [S] are the standard errors of each from its own rounds. Between seeds lies
    :math:`s^2 = \tau^2 + \bar e^2`, of which the second part is known: :math:`\tau` is the
    training spread. Its interval is the chi-square one of :math:`s^2`.
    """
    render = float(np.sqrt(np.mean(np.square(np.concatenate([np.ravel(e) for e in errors])))))
    rows = [np.ravel(np.asarray(v, float)) for v in values]
    dof = sum(len(row) - 1 for row in rows)
    if dof < 1:
        nothing = float("nan")
        return Spread(render, Interval(nothing, nothing, nothing))
    square = sum(float(np.square(row - row.mean()).sum()) for row in rows)
    bounds = (dof, chi2_isf(0.025, dof), chi2_isf(0.975, dof))
    # A variance is not negative: what render noise alone explains leaves no training spread.
    training = (np.sqrt(max(square / bound - render**2, 0.0)) for bound in bounds)
    return Spread(render, Interval(*map(float, training)))


def over_seeds_draws(draws: NDArray, seed: Seed) -> NDArray:
    """Draws [R] of the mean over seeds, from draws [S, R] of each seed's own value.

    One seed keeps its own. Of several, the spread of the seeds' medians counts, which holds
    the noise of measuring: Student's t with S - 1 degrees of freedom.
    """
    seeds, count = draws.shape
    if seeds == 1:
        return draws[0]
    centres = np.median(draws, axis=1)
    error = centres.std(ddof=1) / np.sqrt(seeds)
    t = np.random.default_rng(seed).standard_t(seeds - 1, count)
    return centres.mean() + error * t


def share_interval(hits: ArrayLike, of: int, seed: Seed = 0, level: float = 0.95) -> Interval:
    """Share of materials for which something holds, as a sample of more such materials.

    ``hits`` [R]: of how many of the ``of`` materials it holds, one count for each draw of the
    measurements; the first is that of the measured values themselves. The interval is that of
    draws from Jeffreys' Beta(k + 1/2, of - k + 1/2): 0 of 4 is no proof of never.
    """
    hits = np.asarray(hits, float)
    draws = np.random.default_rng(seed).beta(hits + 0.5, of - hits + 0.5, (40, len(hits)))
    low, high = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2])
    first = hits[0]
    # Jeffreys' ends do not reach what they cannot exclude: none, or all.
    low, high = (float(low) if first else 0.0), (float(high) if first < of else 1.0)
    return Interval(float(first / of), low, high)


def _two_level_quantile(
    logs: list[NDArray], middle: float, rng: np.random.Generator, level: float
) -> float:
    """Quantile of ``|mean* - mean| / s*``, materials and seeds within them resampled."""
    n = len(logs)
    chosen = rng.integers(n, size=(RESAMPLES, n))
    means = np.empty((RESAMPLES, n))
    for material, values in enumerate(logs):
        places = np.nonzero(chosen == material)
        rows = rng.integers(len(values), size=(len(places[0]), len(values)))
        means[places] = values[rows].mean(1)
    off = np.abs(means.mean(1) - middle)
    errors = means.std(1, ddof=1) / np.sqrt(n)
    # A resample of one repeated material: t* is infinite, or nothing where it does not deviate.
    with np.errstate(divide="ignore"):
        t = np.divide(off, errors, out=np.zeros_like(off), where=off > 0)
    return float(np.quantile(t, level, method="higher"))


def _positive(x: ArrayLike) -> NDArray:
    x = np.asarray(x, float).ravel()
    if not len(x) or not (np.isfinite(x).all() and (x > 0).all()):
        raise ValueError(f"a geometric mean needs finite values above zero, got {x}")
    return x
