"""Variance and bias of one sample's weight under constant light, over held-out conditions."""

from __future__ import annotations

from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.results import Results
from harness.report.table import Section, Table
from harness.report.tables.common import circumstances, lowest_wins, material_rows
from harness.stats.variance import WIDEST

ORDER = 110
MEASURE = "sample-weights"
_SECTIONS = (
    ("relative-variance-median", "relative variance of one sample, median condition [1]", "low"),
    ("relative-variance", "relative variance of one sample, mean over conditions [1]", "low"),
    ("noise-free-variance-median", "without the noise of f, median condition [1]", "low"),
    ("noise-free-variance", "without the noise of f, mean over conditions [1]", "low"),
    ("bias", "bias: mean of E[w] / albedo - 1 [1]", ""),
    ("bias-rms", "bias of a condition, root mean square [1]", ""),
    ("biased-share", "share of conditions off by more than three standard errors [1]", ""),
)
_SHARES = (("variance", ""), ("noise_free", ", without the noise of f"))


def sample_weights(results: Results) -> Table | str:
    """A section per quantity: rows materials, columns methods."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    sections = []
    for metric, title, best in _SECTIONS:

        def number(material, method, metric=metric, positive=bool(best)):
            found = results.number(MEASURE, metric, material, method.label)
            return resolved(found) if positive else found

        mean = geometric_mean if best else None
        rows = material_rows(results, number, best, mean, "geometric mean")
        sections.append(Section(title, rows))
    if any(m.label == results.baseline for m in results.methods):
        for metric, title in _SHARES:

            def share(material, method, metric=metric):
                return _share(results, metric, material, method.label)

            title = f"share of conditions with less variance than {results.baseline}{title} [1]"
            sections.append(Section(title, material_rows(results, share, "", None, "")))
    conditions = results.counts(MEASURE, "mean")
    said = circumstances(
        results, MEASURE, f"{conditions} held-out conditions" if conditions else ""
    )
    return lowest_wins(
        results,
        MEASURE,
        sections,
        name=MEASURE,
        title="Weights of samples",
        caption=(
            "Luminance of the weight w of a sample (f/p, or the method's own estimate) in "
            "constant light: variance over the squared albedo, and how far its mean is from the "
            "albedo. After N samples the relative squared error of a condition is bias squared + "
            "variance / N. Where f is itself a mean over random walks, f/p contains its noise, "
            f"which two evaluations by different walks tell apart. Lower is better. {said}"
        ).strip(),
    )


def resolved(found: Estimate | str) -> Estimate | str:
    """``found``, unless its interval spans more than a factor of ``WIDEST``."""
    if isinstance(found, str) or found.low is None or found.high is None:
        return found
    if found.high <= WIDEST * found.low:
        return found
    return f"not resolved: its interval spans more than a factor of {WIDEST:g}"


def _share(results: Results, metric: str, material: str, method: str) -> Estimate | str:
    """Share of conditions in which the method's variance is below the baseline's."""
    if method == results.baseline:
        return "the reference itself"
    variances = []
    for label in (method, results.baseline):
        trials = results.trials(MEASURE, material, label)
        if not trials:
            return results.why_missing(MEASURE, material, label)
        arrays = results.arrays(trials[0])
        noise = arrays["noise"] if metric == "noise_free" else 0.0
        variances.append(arrays["variance"] - noise)
    below = (variances[0] < variances[1]).mean()
    return Estimate(float(below))
