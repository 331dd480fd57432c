"""How far fits from different training seeds lie apart, beside the noise of measuring them."""

from __future__ import annotations

from harness.analysis import numbers
from harness.analysis.combine import Estimate
from harness.analysis.results import MethodColumn, Results
from harness.analysis.seeds import ONE_SEED, training_spread
from harness.report.table import Cell, Row, Section, Table

ORDER = 82
QUANTITIES = (
    ("equal-time", "speedup-equal-time", "speed-up at equal time"),
    ("pdf", "kl", "KL divergence"),
)
_LEGEND = (
    "×1.1: fits from other seeds differ by a factor of 1.1 in one standard deviation, beyond the "
    "noise of measuring each; ×1 where noise alone explains the differences. Brackets: 95% "
    "intervals (chi-square). The intervals of the other tables hold this spread and the noise.",
)


def training_seeds(results: Results) -> Table | str:
    """Sections quantities and scenes; rows materials and all of them together."""
    seeds = len(set(results.training.values()))
    if seeds < 2:
        return f"{ONE_SEED}; a suite asks for more by training_seeds: [0, 1, 2]"
    sections = []
    for measure, metric, words in QUANTITIES:
        if not results.has(measure):
            continue
        for scene in results.scenes(measure):
            title = f"{words}, {scene}" if scene else words
            sections.append(Section(title, _rows(results, measure, metric, scene)))
    if not sections:
        return "no trial of the measures equal-time and pdf is stored"
    return Table(
        name="training-seeds",
        title="Spread between training seeds",
        caption=f"{seeds} training seeds a method and material.",
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        legend=list(_LEGEND),
        measures=tuple(measure for measure, _, _ in QUANTITIES),
    )


def _rows(results: Results, measure: str, metric: str, scene: str) -> list[Row]:
    materials = results.materials
    rows = [
        Row(name, [_cell(results, measure, metric, scene, [name], m) for m in results.methods])
        for name in materials
    ]
    if len(materials) > 1:
        cells = [_cell(results, measure, metric, scene, materials, m) for m in results.methods]
        rows.append(Row("all materials", cells, summary=True))
    return rows


def _cell(
    results: Results,
    measure: str,
    metric: str,
    scene: str,
    materials: list[str],
    method: MethodColumn,
) -> Cell:
    if metric.startswith("speedup") and method.label == results.baseline:
        return Cell(missing="the reference: one by definition", ceiling=method.ceiling)
    groups = [results.by_training(measure, metric, name, method.label, scene) for name in materials]
    known = [group for group in groups if group]
    if not known:
        reason = results.why_missing(measure, materials[0], method.label, scene)
        return Cell(missing=reason, ceiling=method.ceiling)
    spread = training_spread(known)
    if not isinstance(spread, Estimate):
        return Cell(missing=spread, ceiling=method.ceiling)
    text = f"{_factor(spread.value)} [{_factor(spread.low)}, {_factor(spread.high)}]"
    return Cell(spread.value, spread.low, spread.high, text=text, ceiling=method.ceiling)


def _factor(value: float) -> str:
    return f"×{numbers.plain(value, 3 if value < 1.1 else 2)}"
