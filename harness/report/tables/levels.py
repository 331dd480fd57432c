"""How close neural materials come to their surfaces, level by level; their sizes and times."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.table import Cell, Row, Section, Table

ORDER = 130
MEASURE, TIMES = "levels", "stages"
_METRICS = (("mse", "MSE [1]"), ("flip", "FLIP [1]"), ("ssim", "SSIM of log(1 + f) [1]"))
_FACTS = (
    (MEASURE, "network-parameters", "weights of the networks [1]"),
    (MEASURE, "texture-channels", "texture channels [1]"),
    (MEASURE, "texture-numbers", "texture numbers [1]"),
    (TIMES, "stage-1-seconds", "stage 1: offset and lookup [s per million]"),
    (TIMES, "stage-2-seconds", "stage 2: decoder [s per million]"),
    (TIMES, "bare-seconds", "bare torch network [s per million]"),
)


def levels(results: Results) -> Table | str:
    """A section per error, rows materials, columns levels of detail; then sizes and times."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    metrics = set(results.frame.loc[results.frame["measure"] == MEASURE, "metric"])
    count = sum(metric.startswith("mse-") for metric in metrics)
    method = results.methods[0].label

    def cell(measure: str, metric: str, material: str) -> Cell:
        found = results.number(measure, metric, material, method)
        if isinstance(found, str):
            return Cell(missing=found)
        return Cell(found.value, found.low, found.high, warning=found.note)

    sections = [
        Section(
            title,
            [
                Row(material, [cell(MEASURE, f"{metric}-{i}", material) for i in range(count)])
                for material in results.materials
            ],
        )
        for metric, title in _METRICS
        if count
    ]
    empty = [Cell(text=" ")] * max(0, count - 1)
    for measure, metric, title in _FACTS:
        if results.has(measure):
            rows = [Row(m, [cell(measure, metric, m), *empty]) for m in results.materials]
            sections.append(Section(title, rows, brief=False))
    return Table(
        name="levels",
        title="Neural materials across levels of detail",
        caption=(
            "A plane of each material against its path-traced microgeometry; at level l a pixel "
            "is 2^l texels of the finest texture wide. MSE is the median of the views, the truth's "
            "noise taken off; FLIP and SSIM are means; with 95 % intervals. SSIM: higher is better."
        ),
        corner="material",
        columns=[f"level {i}" for i in range(max(count, 1))],
        sections=sections,
        measures=(MEASURE, TIMES),
    )
