"""How close materials learned from walks come to their microgeometry."""

from __future__ import annotations

from harness.analysis.results import Results
from harness.report.table import Cell, Row, Section, Table

ORDER = 135
MEASURE = "walks"
_FACTS = (
    ("albedo-within", "albedo within 3 %"),
    ("albedo-noise", "noise of walks"),
    ("shape-error", "relative squared error of f"),
    ("reciprocity-error", "reciprocity error"),
    ("size-bytes", "bytes"),
)


def walks(results: Results) -> Table | str:
    """Rows materials; columns of energy by angle, then errors and sizes."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    metrics = set(results.frame.loc[results.frame["measure"] == MEASURE, "metric"])
    count = sum(metric.startswith("albedo-ratio-") for metric in metrics)
    method = results.methods[0].label

    def cell(metric: str, material: str) -> Cell:
        found = results.number(MEASURE, metric, material, method)
        if isinstance(found, str):
            return Cell(missing=found)
        return Cell(found.value, found.low, found.high, warning=found.note)

    width = max(count, len(_FACTS))

    def padded(cells: list[Cell]) -> list[Cell]:
        return cells + [Cell(text=" ")] * (width - len(cells))

    energy = [
        Row(m, padded([cell(f"albedo-ratio-{i}", m) for i in range(count)]))
        for m in results.materials
    ]
    facts = [Row(m, padded([cell(metric, m) for metric, _ in _FACTS])) for m in results.materials]
    columns = ", ".join(title for _, title in _FACTS)
    return Table(
        name="walks",
        title="Materials learned from walks beside the walks",
        caption=(
            "Energy: the material's albedo over that of particles walking through its "
            f"microgeometry, at {count} cosines of wi from grazing (left) to the normal, with 95 % "
            "intervals of the walks' noise. Errors: share of directions and channels whose albedo "
            "is within 3 %; the 95th percentile of the walks' own relative error; squared error of "
            "f over 144 cells over its square, the walks' noise taken off, median over directions "
            "and channels; mean absolute difference of f both ways over its mean; bytes stored."
        ),
        corner="material",
        columns=[f"({i + 1})" for i in range(width)],
        sections=[
            Section("albedo over the walks', by angle [1]", energy),
            Section(columns, facts, brief=False),
        ],
    )
