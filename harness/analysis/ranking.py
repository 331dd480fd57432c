"""Which method is best over materials, and how sure that is: materials, seeds and noise apart."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from harness.analysis.combine import Z95, Estimate
from harness.analysis.results import SHOWN, MethodColumn, Results
from harness.stats.intervals import log_speed_up
from harness.stats.levels import share_interval, spread_by_level, two_level_mean

MEASURE, METRIC = "equal-time", "speedup-equal-time"
DRAWS = 2000
_ARRAYS = ("baseline_variance", "batch_variance", "baseline_seconds", "seconds")


@dataclass(frozen=True)
class Measured:
    """One speed-up's logarithm, its standard error, and draws [R] of it."""

    log: float
    error: float
    draws: NDArray


@dataclass(frozen=True)
class Standing:
    """One method over all materials. A string says why there is no number.

    ``mean``: geometric mean of the speed-ups, as of a sample of such materials and seeds;
    ``best``: share of materials on which it is best; ``render`` and ``training``: spread of a
    speed-up from render noise, and from the seed of the fit, as factors of one standard deviation.
    """

    method: MethodColumn
    mean: Estimate | str
    best: Estimate | str
    render: Estimate | str
    training: Estimate | str


def standings(
    results: Results,
    scene: str,
    biased: Callable[[str, str], bool] = lambda material, method: False,
) -> list[Standing]:
    """Every method's, in the suite's order; one ``biased`` on a material cannot be best there."""
    cells = {
        (m, c.label): _measured(results, m, c.label, scene)
        for m in results.materials
        for c in results.methods
    }
    best = _best(results, cells, biased)
    return [_standing(results, method, cells, best) for method in results.methods]


def _standing(
    results: Results,
    method: MethodColumn,
    cells: dict[tuple[str, str], list[Measured] | str],
    best: dict[str, NDArray],
) -> Standing:
    found = {m: cells[m, method.label] for m in results.materials}
    known = [each for each in found.values() if not isinstance(each, str)]
    if not known:
        reason = str(next(iter(found.values())))
        return Standing(method, reason, reason, reason, reason)
    logs = [[one.log for one in each] for each in known]
    value, low, high = two_level_mean([np.exp(row) for row in logs], _seed("mean", method.label))
    short = "" if len(known) == len(found) else f"{len(known)} of {len(found)} materials only"
    mean = Estimate(value, note=short) if math.isnan(low) else Estimate(value, low, high, short)
    if method.label == results.baseline:
        # By definition, not measurement.
        mean, told = Estimate(1.0, 1.0, 1.0), "the reference: one by definition"
        return Standing(method, mean, _share(best, method, found), told, told)
    spread = spread_by_level(logs, [[one.error for one in each] for each in known])
    training: Estimate | str = "one seed a fit: no training spread"
    if not math.isnan(spread.training.value):
        training = Estimate(*map(math.exp, spread.training))
    render: Estimate | str = Estimate(math.exp(spread.render))
    if math.isnan(spread.render):
        render = "no rounds stored to tell it from"
    return Standing(method, mean, _share(best, method, found), render, training)


def _share(
    best: dict[str, NDArray], method: MethodColumn, found: dict[str, list[Measured] | str]
) -> Estimate | str:
    if method.ceiling:
        return "the ceiling does not compete"
    hits = best[method.label]
    return Estimate(*share_interval(hits, len(found), _seed("share", method.label)))


def _best(
    results: Results,
    cells: dict[tuple[str, str], list[Measured] | str],
    biased: Callable[[str, str], bool],
) -> dict[str, NDArray]:
    """By method: on how many materials it is best, as measured and in each draw, [1 + R]."""
    labels = [method.label for method in results.methods if not method.ceiling]
    counts = {label: np.zeros(1 + DRAWS) for label in labels}
    for material in results.materials:
        rows = []
        for label in labels:
            found = cells[material, label]
            # Nor can a method without a number be the best.
            out = isinstance(found, str) or biased(material, label)
            rows.append(np.full(1 + DRAWS, -np.inf) if out else _mean(found))
        logs = np.stack(rows)
        winner = logs.argmax(0)
        for i, label in enumerate(labels):
            counts[label] += (winner == i) & (logs[i] > -np.inf)
    return counts


def _mean(found: list[Measured]) -> NDArray:
    """Over seeds [1 + R]: the value, and draws that resample the seeds."""
    draws = np.stack([one.draws for one in found])
    which = np.random.default_rng(len(found)).integers(len(found), size=draws.shape)
    return np.append(
        np.mean([one.log for one in found]), np.take_along_axis(draws, which, 0).mean(0)
    )


def _measured(results: Results, material: str, method: str, scene: str) -> list[Measured] | str:
    """One for each training seed with a number, or why there is none."""
    rows = [
        row
        for row in results.rows(MEASURE, material, method, scene)
        if row["metric"] == METRIC and row["status"] in SHOWN and 0 < row["value"] < math.inf
    ]
    if not rows:
        number = results.number(MEASURE, METRIC, material, method, scene)
        return number if isinstance(number, str) else f"a speed-up of {number.value:g}"
    fits: dict[int, list[Measured]] = {}
    for row in rows:
        one = _one(results, row, method == results.baseline)
        fits.setdefault(results.training.get(row["trial"], row["seed"]), []).append(one)
    return [_of_one_fit(found) for found in fits.values()]


def _of_one_fit(found: list[Measured]) -> Measured:
    """Over the seeds that one fit is measured with, which are independent."""
    return Measured(
        float(np.mean([one.log for one in found])),
        math.hypot(*(one.error for one in found)) / len(found),
        np.mean([one.draws for one in found], axis=0),
    )


def _one(results: Results, row: dict, baseline: bool) -> Measured:
    if baseline:
        return Measured(0.0, 0.0, np.zeros(DRAWS))
    seed = _seed(row["trial"])
    factor = results.factors.found.get((row["trial"], METRIC))
    if factor is not None:
        # Half the width of the interval tells the error, as it would of a normal one.
        error = (factor.log.below + factor.log.above) / (2 * Z95)
        return Measured(factor.log.theta, error, factor.log.draws(DRAWS, seed))
    arrays = results.arrays(row["trial"])
    if all(name in arrays for name in _ARRAYS):
        estimate = log_speed_up(*(arrays[name] for name in _ARRAYS), seed)
        return Measured(estimate.theta, estimate.error, estimate.draws(DRAWS, seed))
    low, high = row["ci_low"], row["ci_high"]
    middle = math.log(row["value"])
    if math.isnan(low) or not low > 0:
        return Measured(middle, math.nan, np.full(DRAWS, middle))
    error = math.log(high / low) / (2 * Z95)
    normal = np.random.default_rng(seed).standard_normal(DRAWS)
    return Measured(middle, error, middle + error * normal)


def _seed(*what: object) -> int:
    return crc32("\0".join(map(str, what)).encode())
