"""Is a method right as a renderer uses it? White furnace, mean images, MIS."""

from __future__ import annotations

from harness.analysis import numbers
from harness.analysis.bias import LEVEL
from harness.analysis.combine import Estimate
from harness.analysis.results import SHOWN, MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import cell, circumstances
from harness.stats.ztest import holm

ORDER = 100
MEASURE = "image-checks"
CHECKS = {
    "furnace": "furnace: constant light against the albedo",
    "reference": "BSDF samples against the reference",
    "mis": "MIS against BSDF samples",
    "mis-reference": "MIS against the reference",
    "tripled": "MIS told 3 p against MIS",
    "tilted": "MIS told exp(2x) p against MIS",
}
RATIOS = {
    "mis-variance": "variance of MIS over BSDF samples",
    "tripled-variance": "variance of MIS told 3 p over MIS",
    "tilted-variance": "variance of MIS told exp(2x) p over MIS",
}
NOISELESS = "neither image has noise above the rounding of single precision"

Key = tuple[str, str, str, str]
"""(check, material, method label, scene)"""


def image_checks(results: Results) -> Table | str:
    """A section per scene and material: p-values of the comparisons, and ratios of variances."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    corrected = corrected_p(results)
    sections = []
    for scene in results.scenes(MEASURE):
        for material in results.materials:
            at = material, scene
            rows = [
                Row(words, [_p_cell(results, corrected, check, m, *at) for m in results.methods])
                for check, words in CHECKS.items()
            ]
            rows += [
                Row(words, [_ratio_cell(results, ratio, m, *at) for m in results.methods])
                for ratio, words in RATIOS.items()
            ]
            sections.append(Section(f"{scene}, {material}", rows))
    found = sum(p < LEVEL for p in corrected.values())
    said = circumstances(results, MEASURE)
    return Table(
        name=MEASURE,
        title="Image checks",
        caption=(
            "p-values of the mean images that must agree, after Holm's correction over the "
            f"{len(corrected)} tests of this table: a correct method is called wrong (‡) anywhere "
            f"in it with at most the chance {LEVEL:g}: {found or 'none'} of {len(corrected)}. A "
            "density that MIS alone is told wrongly changes the variance of one sample, and must "
            f"not change the mean. {said}"
        ).strip(),
        corner="check",
        columns=[method.label for method in results.methods],
        sections=sections,
        measures=(MEASURE,),
    )


def corrected_p(results: Results) -> dict[Key, float]:
    """Holm-corrected p-values of all tests stored; the smallest over seeds for each cell."""
    rows = [row for row in results.rows(MEASURE) if row["status"] in SHOWN]
    tests = [
        (check, row)
        for row in rows
        for check in CHECKS
        if row["metric"] == f"{check}-p" and row["value"] == row["value"]
    ]
    corrected: dict[Key, float] = {}
    for (check, row), p in zip(tests, holm([row["value"] for _, row in tests]), strict=True):
        key = (check, row["material"], row["method"], row["scene"])
        corrected[key] = min(float(p), corrected.get(key, 1.0))
    return corrected


def _p_cell(
    results: Results,
    corrected: dict[Key, float],
    check: str,
    method: MethodColumn,
    material: str,
    scene: str,
) -> Cell:
    raw = results.number(MEASURE, f"{check}-p", material, method.label, scene)
    if isinstance(raw, str):
        return Cell(missing=raw, ceiling=method.ceiling)
    p = corrected[(check, material, method.label, scene)]
    warning = raw.note
    if p < LEVEL:
        off = results.number(MEASURE, check, material, method.label, scene)
        size = f" by {off.value:+.2%}" if isinstance(off, Estimate) else ""
        differs = f"{method.label} on {material}, {CHECKS[check]}: differs{size}"
        warning = "; ".join(filter(None, [differs, warning]))
    return Cell(p, text=numbers.p_value(p), warning=warning, ceiling=method.ceiling)


def _ratio_cell(
    results: Results, ratio: str, method: MethodColumn, material: str, scene: str
) -> Cell:
    number = results.number(MEASURE, ratio, material, method.label, scene)
    if isinstance(number, str) and results.trials(MEASURE, material, method.label, scene):
        number = NOISELESS
    return cell(number, method, suffix="×")
