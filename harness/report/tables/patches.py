"""Renders of materials learned from walks beside path-traced geometry (PureSample, Table 1)."""

from __future__ import annotations

from harness.analysis.combine import Estimate
from harness.analysis.quantities import scaled
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import cell, circumstances

ORDER = 133
MEASURE = "patches"
TRUTH_SPP, SPP = 1024, 16
"""Samples a pixel of the paper's Table 1."""
_COLUMNS = (
    (f"geometry, {TRUTH_SPP} spp [s]", "truth-seconds-per-spp", float(TRUTH_SPP)),
    (f"learned, {SPP} spp [s]", "seconds-per-spp", float(SPP)),
    ("geometry [MB]", "truth-size-bytes", 1e-6),
    ("learned [MB]", "size-bytes", 1e-6),
    ("noise of geometry", "truth-noise", 1.0),
    ("noise of learned", "noise", 1.0),
    ("geometry's time over learned's at the same noise", "same-noise-time-ratio", 1.0),
    ("difference at large", "macro-error", 1.0),
)


def patches(results: Results) -> Table | str:
    """A section per scene and method: rows materials, columns time, storage, noise, difference."""
    if not results.trials(MEASURE):
        return f"no trial of the measure {MEASURE} ended well"
    sections = []
    for scene in results.scenes(MEASURE):
        for method in results.methods:
            if not results.rows(MEASURE, None, method.label, scene):
                continue
            rows = [_row(results, material, method, scene) for material in results.materials]
            sections.append(Section(f"{scene}, {method.label}", rows))
    return Table(
        name=MEASURE,
        title="Learned from walks, beside path-traced geometry",
        caption=(
            f"Seconds for the paper's {TRUTH_SPP} samples a pixel of Mitsuba's path tracer on the "
            f"triangles of the geometry and {SPP} of the learned material on a flat sheet, from "
            "medians over rounds with 95 % intervals; bytes of one tile's triangles, which are "
            "instanced, and of the networks. Noise: variance of one sample of a pixel over the "
            "mean square. At the same noise: seconds times variance of geometry over those of the "
            "learned. Difference at large: squared difference of means over 6 x 6 blocks of a "
            "picture over the mean square, the noise of both taken off (it may come out below "
            f"zero). {circumstances(results, MEASURE, timed=True)}"
        ).strip(),
        corner="material",
        columns=[title for title, _, _ in _COLUMNS],
        sections=sections,
        measures=(MEASURE,),
    )


def _row(results: Results, material: str, method: MethodColumn, scene: str) -> Row:
    cells: list[Cell] = []
    for _, metric, factor in _COLUMNS:
        found = results.number(MEASURE, metric, material, method.label, scene)
        number = scaled(found, factor) if isinstance(found, Estimate) else found
        cells.append(cell(number, method))
    return Row(material, cells)
