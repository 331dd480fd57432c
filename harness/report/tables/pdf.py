"""How close each method's pdf comes to the target, over conditions held out from fitting."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from harness.analysis.combine import Estimate, arithmetic_mean, geometric_mean
from harness.analysis.results import Results
from harness.report.series.slices import BELOW_ZERO, REACHES_BELOW
from harness.report.table import Section, Table
from harness.report.tables.common import Mean, circumstances, lowest_wins, material_rows

N = TypeVar("N", Estimate, Estimate | str)

ORDER = 40
MEASURE = "pdf"
_METRICS = (
    ("kl", "KL(p* ∥ p) [nats]", arithmetic_mean, "mean", True),
    ("chi2", "χ² divergence [1]", geometric_mean, "geometric mean", True),
    (
        "chi2-median",
        "χ² divergence, median condition [1]",
        geometric_mean,
        "geometric mean",
        False,
    ),
    ("mse", "MSE [1]", geometric_mean, "geometric mean", False),
    ("invalid-share", "share of invalid samples [1]", None, "", False),
    ("lost-share", "share of p* never sampled [1]", None, "", False),
)


def pdf(results: Results) -> Table | str:
    """A section per divergence: rows materials, columns methods, lower is better."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    sections = []
    for metric, title, mean, mean_label, brief in _METRICS:
        if not (results.frame["metric"] == metric).any():
            continue

        def number(material, method, metric=metric):
            return _explained(results.number(MEASURE, metric, material, method.label))

        # A share of invalid samples is no contest: cosine has none and is no better for it.
        best = "low" if mean is not None else ""
        rows = material_rows(results, number, best, mean and _of(mean), mean_label)
        sections.append(Section(title, rows, brief))
    if not sections:
        rows = material_rows(
            results, lambda m, c: results.number(MEASURE, "kl", m, c.label), "", None, ""
        )
        sections = [Section("KL(p* ∥ p) [nats]", rows)]
    conditions = results.counts(MEASURE, "kl")
    said = circumstances(
        results, MEASURE, f"{conditions} held-out conditions" if conditions else ""
    )
    return lowest_wins(
        results,
        MEASURE,
        sections,
        name="pdf",
        title="Quality of the pdf",
        caption=(
            "Divergence of the method's pdf p from the target p*, the normalised luminance of "
            "the BSDF over the projected disk; mean over conditions held out from fitting. The χ² "
            f"divergence is the variance under constant light. Lower is better. {said}"
        ).strip(),
    )


def _of(mean: Mean) -> Mean:
    """The mean, with its reason where it is below zero."""
    return lambda estimates, count: _explained(mean(estimates, count))


def _explained(number: N) -> N:
    """A number, with the reason in its note where it or its interval is below zero."""
    if isinstance(number, str):
        return number
    if number.value < 0:
        why = BELOW_ZERO
    elif number.has_interval and number.low < 0:
        why = REACHES_BELOW
    else:
        return number
    return replace(number, note="; ".join(filter(None, [number.note, why])))
