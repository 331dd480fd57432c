r"""When a costlier method has paid for itself: total time to a given error, as straight lines.

The unit of work is one sample of the reference method: after :math:`N` of them its error is
:math:`v_r / N`, and a method of variance :math:`v` reaches the same with :math:`N v / v_r`
samples, in

.. math:: T(N) = F + N\,\frac{v}{v_r}\,t

seconds: :math:`F` are those before the first sample (fitting, unless it is shipped, and
loading), :math:`t` those of one sample of one pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from harness.analysis.combine import Z95, Estimate
from harness.analysis.marks import disturbed
from harness.analysis.results import SHOWN, MethodColumn, Results
from harness.stats.crossing import Crossing, crossing
from harness.stats.distributions import t_quantile
from harness.stats.intervals import interval_of_draws
from harness.stats.levels import over_seeds_draws
from harness.stats.log_estimate import FEWEST, log_mean, log_median
from harness.store.frame import STALE

DRAWS = 4000
TIMES = ("equal-time", "cost")
"""Measures that store ``seconds`` per sample per pixel [rounds]; the first that has them."""
VARIANCES = ("equal-time", "equal-spp", "cost")
"""Measures that store ``batch_variance`` [batches]."""


@dataclass(frozen=True)
class CostLine:
    """Total time of one method: ``fixed`` seconds, ``slope`` seconds per reference sample.

    Both are [1 + R]: the value, then its draws. ``mark`` says if a timing was
    disturbed or is stale.
    """

    method: MethodColumn
    fixed: NDArray
    slope: NDArray
    mark: str = ""

    def total(self, samples: float) -> NDArray:
        """Seconds until the error that ``samples`` of the reference reach, [1 + R]."""
        return self.fixed + samples * self.slope

    def totals(self, samples: NDArray) -> NDArray:
        """:meth:`total` at each of ``samples`` [P]: value and ends of its 95 % interval, [3, P]."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = self.fixed + samples[:, None] * self.slope
        return np.vstack([found[None, :, 0], interval_of_draws(found[:, 1:])])

    def against(self, rival: CostLine) -> Crossing:
        """Where this method's total time is at most the rival's."""
        return crossing(self.fixed, self.slope, rival.fixed, rival.slope)


@dataclass(frozen=True)
class Costs:
    """The lines of all methods on one material in one scene; ``missing`` says why not."""

    material: str
    scene: str
    reference: str
    lines: dict[str, CostLine]
    missing: dict[str, str]


def timed_scenes(results: Results) -> list[str]:
    """Scenes with times per sample."""
    return list(dict.fromkeys(s for measure in TIMES for s in results.scenes(measure)))


def costs(results: Results, material: str, scene: str, shipped: bool = False) -> Costs | str:
    """Lines of all methods, or why there is no reference to count samples in.

    ``shipped``: the fit comes with the method and costs nothing. Times are drawn from the same
    rounds for all methods, so that drift that hits all alike cancels in their ratios.
    """
    reference = results.baseline
    found = {m.label: results.once(_log_cost, material, m.label, scene) for m in results.methods}
    base = found.get(reference, "no such method in the suite")
    if isinstance(base, str):
        return f"{reference or 'the baseline'} on {material} in {scene}: {base}"
    lines, missing, at = {}, {}, (material, scene)
    for method in results.methods:
        cost = found[method.label]
        start = _start(results, material, method.label, scene, shipped)
        if isinstance(cost, str) or isinstance(start, str):
            missing[method.label] = cost if isinstance(cost, str) else str(start)
            continue
        # A draw of a variance that is hardly known may be anything: infinite never pays.
        with np.errstate(over="ignore"):
            slope = np.exp(cost.variance - base.variance + cost.seconds)
        lines[method.label] = CostLine(method, start, slope, _mark(results, *at, method.label))
    return Costs(material, scene, reference, lines, missing)


def _mark(results: Results, material: str, scene: str, method: str) -> str:
    """What is to be known of a method's timings: disturbed, or by code that has changed since."""
    old = any(
        row["status"] == STALE
        for measure in dict.fromkeys(TIMES + VARIANCES)
        for row in results.rows(measure, material, method, scene)
    )
    said = disturbed(results, TIMES, material, method, scene)
    return "; ".join(filter(None, [said, "stale" * old]))


# --- from what is stored -----------------------------------------------------------------------


@dataclass(frozen=True)
class _LogCost:
    """Logarithms [1 + R] of the variance of a sample, and of its seconds."""

    variance: NDArray
    seconds: NDArray


def _log_cost(results: Results, material: str, method: str, scene: str) -> _LogCost | str:
    at = (material, method, scene)
    variances = _stored(results, VARIANCES, "batch_variance", *at)
    seconds = _stored(results, TIMES, "seconds", *at)
    for found in (variances, seconds):
        if isinstance(found, str):
            return found
    drawn = []
    for seed, array in variances.items():
        if not (array > 0).all():
            return "a variance of zero, or below what rounding resolves: no ratio with it"
        estimate = log_mean(array, _seed("variance", *at, seed))
        if not estimate.dof > 0:
            return "one batch only: its variance has no interval"
        draws = estimate.draws(DRAWS, _seed("variance draws", *at, seed))
        drawn.append(np.append(estimate.theta, draws))
    # The rounds of one material, scene and seed are shared: so are their resamples.
    timed = [_log_seconds(array, _seed(material, scene, seed)) for seed, array in seconds.items()]
    if any(isinstance(one, str) for one in timed):
        return "one round only: its time has no interval"
    return _LogCost(_over_seeds(drawn, _seed("v", *at)), _over_seeds(timed, _seed("t", *at)))


def _log_seconds(seconds: NDArray, seed: int) -> NDArray | str:
    """Log of the median of rounds, and draws of it."""
    n = len(seconds)
    if n < 2:
        return "too few"
    estimate = log_median(seconds, seed)
    if n < FEWEST:
        return np.append(estimate.theta, estimate.draws(DRAWS, seed))
    rows = np.random.default_rng(seed).integers(n, size=(DRAWS, n))
    off = np.median(np.log(seconds)[rows], axis=1) - estimate.theta
    # Student's tail replaces the normal one, as in the interval of a median's logarithm.
    student = t_quantile(0.975, n - 1) / Z95
    return np.append(estimate.theta, estimate.theta + student * off)


def _over_seeds(drawn: list[NDArray], seed: int) -> NDArray:
    """[1 + R] of the mean over seeds, from that of each."""
    together = np.stack(drawn)
    return np.append(together[:, 0].mean(), over_seeds_draws(together[:, 1:], seed))


def _stored(
    results: Results, measures: tuple[str, ...], name: str, material: str, method: str, scene: str
) -> dict[int, NDArray] | str:
    """The array of every seed, from the first measure that stores it; times per single sample."""
    reasons = []
    for measure in measures:
        rows = results.rows(measure, material, method, scene)
        if not rows:
            continue
        trials = {row["seed"]: row["trial"] for row in rows if row["status"] in SHOWN}
        found = {
            seed: np.asarray(arrays[name], float)
            for seed, trial in trials.items()
            if name in (arrays := results.arrays(trial))
        }
        if found:
            if name != "seconds":
                return found
            return {seed: array / _pixels(results, trials[seed]) for seed, array in found.items()}
        if not trials:
            reasons.append(results.why_missing(measure, material, method, scene))
    needs = "a time per sample" if name == "seconds" else "a variance"
    return reasons[0] if reasons else f"not measured: {needs} takes one of {', '.join(measures)}"


def _pixels(results: Results, trial: str) -> int:
    """Pixels of the trial's image: its times are for one sample in each."""
    return int(results.stored(trial).trial["measure"]["settings"]["resolution"]) ** 2


def _start(
    results: Results, material: str, method: str, scene: str, shipped: bool
) -> NDArray | str:
    """Seconds before the first sample, [1 + R]: fit, unless shipped, and load (with compiling)."""
    cold = [results.number("cost", m, material, method, scene) for m in _COLD]
    if any(isinstance(part, str) for part in cold):
        cold = [results.number("fit", "load-seconds", material, method)]
    fit = [] if shipped else [results.number("fit", "fit-seconds", material, method)]
    total = np.zeros(1 + DRAWS)
    for i, part in enumerate([*cold, *fit]):
        if isinstance(part, str):
            return part
        total = total + _draws(part, _seed("start", material, method, scene, i))
    return total


_COLD = ("load-seconds", "compile-seconds")


def _draws(estimate: Estimate, seed: int) -> NDArray:
    """The value and draws whose 2.5 and 97.5 percentiles are its bounds; constant without."""
    if not estimate.has_interval:
        return np.full(1 + DRAWS, estimate.value)
    z = np.random.default_rng(seed).standard_normal(DRAWS)
    if estimate.low > 0:
        up, down = np.log(estimate.high / estimate.value), np.log(estimate.value / estimate.low)
        drawn = estimate.value * np.exp(np.where(z > 0, up, down) * z / Z95)
    else:
        up, down = estimate.high - estimate.value, estimate.value - estimate.low
        drawn = estimate.value + np.where(z > 0, up, down) * z / Z95
    return np.append(estimate.value, drawn)


def _seed(*what: object) -> int:
    """The same records draw the same numbers, and different ones different numbers."""
    return crc32("\0".join(map(str, what)).encode())
