"""What accuracy-against-time charts plot: which recorded number goes on which axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from harness.analysis.combine import Estimate
from harness.analysis.quantities import nanoseconds_per_sample, scaled
from harness.analysis.results import Results

Number = Callable[[Results, str, str, str], Estimate | str]
"""(results, material, method, scene) -> the number, or the reason why there is none."""


@dataclass(frozen=True)
class Chart:
    """Two numbers of every method. ``caption`` has a place for ``{where}``.

    ``measure`` whose scenes the chart is made for; "" for one without a scene. ``level``
    tells what has no place on the x axis and is drawn across it.
    """

    name: str
    title: str
    x: Number
    y: Number
    x_title: str
    y_title: str
    caption: str
    measure: str = ""
    level: Callable[[Results, str, str], bool] = lambda results, material, method: False
    note: Callable[[Results], str] = lambda results: ""

    def scenes(self, results: Results) -> list[str]:
        """Scenes to make it for."""
        if self.in_scene(results):
            return results.scenes(self.measure or "equal-time")
        return [""]

    def in_scene(self, results: Results) -> bool:
        """Whether one of its numbers belongs to a scene."""
        return bool(self.measure) or (
            self.x is sampling_time and _sampling_source(results) == "equal-time"
        )


def sampling_time(results: Results, material: str, method: str, scene: str) -> Estimate | str:
    """Nanoseconds per sample: of the sampler alone where that was measured, else rendered."""
    source = _sampling_source(results)
    if source == "cost":
        for here in results.scenes("cost"):
            found = results.number("cost", "seconds-per-million-samples", material, method, here)
            if isinstance(found, Estimate):
                return scaled(found, 1e3)
        return found
    if source == "throughput":
        rate = results.number("throughput", "samples-per-second", material, method)
        return rate if isinstance(rate, str) else _reciprocal(rate, 1e9)
    here = scene or next(iter(results.scenes("equal-time")), "")
    return nanoseconds_per_sample(results, material, method, here)


def _sampling_source(results: Results) -> str:
    return next((m for m in ("cost", "throughput") if results.trials(m)), "equal-time")


def _reciprocal(estimate: Estimate, factor: float) -> Estimate:
    """``factor`` over it; the bounds change sides."""
    value = factor / estimate.value
    if not estimate.has_interval or estimate.low <= 0:
        return Estimate(value, note=estimate.note)
    return Estimate(value, factor / estimate.high, factor / estimate.low, estimate.note)


def divergence(results: Results, material: str, method: str, scene: str) -> Estimate | str:
    """Chi-square divergence of the pdf, mean over held-out conditions."""
    return results.number("pdf", "chi2", material, method)


def error_at_deadline(results: Results, material: str, method: str, scene: str) -> Estimate | str:
    """Mean squared error of the render that fits the deadline."""
    return results.number("equal-time", "mse-at-deadline", material, method, scene)


def fitting_time(results: Results, material: str, method: str, scene: str) -> Estimate | str:
    """Seconds of a fit, over training seeds."""
    return results.number("fit", "fit-seconds", material, method)


def nothing_fitted(results: Results, material: str, method: str) -> bool:
    """Whether the method has no fitted numbers: its fitting time is none, not a short one."""
    count = results.number("fit", "parameters", material, method)
    return isinstance(count, Estimate) and count.value == 0


def _one_fit(results: Results) -> str:
    if results.frame["seed"].nunique() > 1:
        return "Intervals of fitting times are over training seeds."
    return "One fit each: intervals of fitting times say how steadily it ran."


CHARTS = (
    Chart(
        "sampling",
        "What accuracy costs in sampling time",
        sampling_time,
        divergence,
        "ns per sample",
        "χ² divergence",
        "χ² divergence of the pdf from its target (the variance under constant light) against the "
        "time of one sample{where}.",
    ),
    Chart(
        "render",
        "Error at equal render time",
        sampling_time,
        error_at_deadline,
        "ns per sample",
        "MSE at the deadline",
        "Mean squared error of a render of fixed time{where} against the time of one sample.",
        measure="equal-time",
    ),
    Chart(
        "fitting",
        "What accuracy costs in fitting time",
        fitting_time,
        divergence,
        "seconds of fitting",
        "χ² divergence",
        "χ² divergence of the pdf from its target against the time of the fit. Dashed across: "
        "methods with nothing to fit, which take no part in the front.",
        level=nothing_fitted,
        note=_one_fit,
    ),
)
