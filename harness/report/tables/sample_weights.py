"""Variance and bias of one sample's weight under constant light, over held-out conditions."""

from __future__ import annotations

from harness.report.combine import geometric_mean
from harness.report.results import Results
from harness.report.table import Section, Table
from harness.report.tables.common import circumstances, legend, material_rows

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


def sample_weights(results: Results) -> Table | str:
    """A section per quantity: rows materials, columns methods."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    sections = []
    for metric, title, best in _SECTIONS:

        def number(material, method, metric=metric):
            return results.number(MEASURE, metric, material, method.label)

        mean = geometric_mean if best else None
        rows = material_rows(results, number, best, mean, "geometric mean")
        sections.append(Section(title, rows))
    conditions = results.counts(MEASURE, "mean")
    said = circumstances(
        results, MEASURE, f"{conditions} held-out conditions" if conditions else ""
    )
    return Table(
        name=MEASURE,
        title="Weights of samples",
        caption=(
            "Luminance of the weight w of a sample (f/p, or the method's own estimate) in "
            "constant light: variance over the squared albedo, and how far its mean is from the "
            "albedo. After N samples the relative squared error of a condition is bias squared + "
            "variance / N. Where f is itself a mean over random walks, f/p contains its noise, "
            f"which two evaluations by different walks tell apart. Lower is better. {said}"
        ).strip(),
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        best="low",
        legend=legend(results),
    )
