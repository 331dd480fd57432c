"""Speed-up factors over the baseline, at equal time or at equal samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from harness.analysis.bias import bias_warnings
from harness.analysis.combine import Estimate, geometric_mean, ratio
from harness.analysis.marks import disturbed
from harness.analysis.resolution import resolved
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Row, Section, Table
from harness.report.tables.common import as_baseline, circumstances, legend, material_rows

_MEAN_LEGEND = "Geometric mean: the materials as given; its interval is that of the measurements."
_POOLED = (
    "Variances are of all renders of a cell, each by its samples. No number: an interval of more "
    "than a factor ten, or a tail that the renders do not resolve; its note has the bound."
)
_EXACT = (
    "Under constant light the variance is an integral over all pixels (measure constant-light) "
    "wherever that is resolved, whatever few renders say; the times are the timed rounds'. Where "
    "renders contradict it by more than three standard errors, a note has both."
)
_UNDIAGNOSED = (
    "Tails not diagnosed in {count} of {all} trials, stored without what tells them: their "
    "factors are of the timed renders alone, and their intervals of light tails."
)


def speedups(
    results: Results, name: str, title: str, metric: str, caption: str, timed: bool = False
) -> Table | str:
    """A section per scene, a row per material, their geometric mean below."""
    # The timed measure compares with the baseline batch by batch; without it, the ratio of the
    # two recorded variances serves for equal samples.
    measure = "equal-time" if timed or results.has("equal-time") else "equal-spp"
    if not results.has(measure):
        return f"no trial of the measure {measure} is stored"
    warnings = bias_warnings(results)
    sections = [
        Section(scene, _rows(results, measure, metric, scene, warnings))
        for scene in results.scenes(measure)
    ]
    caption = caption.format(baseline=results.baseline or "the baseline")
    if len(sections) == 1:
        caption += f" Scene: {sections[0].title}."
        sections = [replace(sections[0], title="")]
    rounds = results.counts(measure, "seconds")
    batches = results.counts(measure, "batch_variance")
    counts = (
        f"{rounds} interleaved rounds" if rounds and timed else "",
        f"{batches} independent renders" if batches else "",
    )
    said = circumstances(results, measure, *counts, timed=timed)
    return Table(
        name=name,
        title=title,
        caption=f"{caption} {said}".strip(),
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        best="high",
        legend=[
            *legend(results),
            *([_MEAN_LEGEND] * (len(results.materials) > 1)),
            *_about_tails(results, measure),
        ],
        measures=(measure, "equal-spp"),
    )


def _about_tails(results: Results, measure: str) -> list[str]:
    trials = results.trials(measure)
    old = sum(trial in results.factors.undiagnosed for trial in trials)
    kinds = results.factors.kinds(trials)
    said = [f"{_POOLED} Tails: {kinds}."] if kinds else []
    found = results.factors.found
    if any(factor.exact for (trial, _), factor in found.items() if trial in set(trials)):
        said.append(_EXACT)
    return said + ([_UNDIAGNOSED.format(count=old, all=len(trials))] if old else [])


def _rows(
    results: Results,
    measure: str,
    metric: str,
    scene: str,
    warnings: Callable[[str, str, str], str],
) -> list[Row]:
    def number(material: str, method: MethodColumn) -> Estimate | str:
        if measure == "equal-time":
            found = results.number(measure, metric, material, method.label, scene)
        else:
            found = _variance_ratio(results, material, method.label, scene)
        if method.label == results.baseline and isinstance(found, Estimate):
            return Estimate(1.0, 1.0, 1.0)
        return resolved(found)

    def mark(material: str, method: str) -> str:
        # Only the time of a speed-up can be disturbed; the baseline's own is 1 by definition.
        timed = metric == "speedup-equal-time" and method != results.baseline
        return disturbed(results, [measure], material, method, scene) if timed else ""

    rows = material_rows(
        results,
        number,
        "high",
        geometric_mean,
        "geometric mean",
        suffix="×",
        warning=lambda material, method: "; ".join(
            filter(None, (warnings(material, method.label, scene), mark(material, method.label)))
        ),
        biased=lambda material, method: bool(warnings(material, method.label, scene)),
    )
    return [_with_baseline(row, results) for row in rows]


def _variance_ratio(results: Results, material: str, method: str, scene: str) -> Estimate | str:
    """Variance of the baseline over the method's; by old records taken as independent."""
    keys = dict.fromkeys(r["trial"] for r in results.rows("equal-spp", material, method, scene))
    pooled = {key: results.factors.found.get((key, "speedup-equal-spp")) for key in keys}
    if found := {key: factor for key, factor in pooled.items() if factor is not None}:
        return results.factor(found)
    pair = [
        results.number("equal-spp", "variance", material, label, scene)
        for label in (results.baseline, method)
    ]
    for number in pair:
        if isinstance(number, str):
            return number
    return ratio(*pair)


def _with_baseline(row: Row, results: Results) -> Row:
    """The baseline's own entry is 1 by definition and is written so."""
    cells = list(row.cells)
    for i, method in enumerate(results.methods):
        if method.label == results.baseline and not cells[i].missing:
            plain = as_baseline("1×", method)
            kept = {key: getattr(cells[i], key) for key in ("bold", "warning", "biased")}
            cells[i] = replace(plain, **kept)
    return replace(row, cells=cells)
