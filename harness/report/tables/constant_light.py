"""Variance under constant light by quadrature, and what of it is the pixel's and no sampler's."""

from __future__ import annotations

from harness.analysis.combine import Estimate
from harness.analysis.quantities import scaled
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Section, Table
from harness.report.tables.common import circumstances, lowest_wins, material_rows

ORDER = 32
MEASURE = "constant-light"


def constant_light(results: Results) -> Table | str:
    """The variance of one sample of a pixel, and the footprint's share of it."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    sections = []
    for scene in results.scenes(MEASURE):
        if not results.trials(MEASURE, scene=scene):
            continue

        def variance(material: str, method: MethodColumn, scene: str = scene) -> Estimate | str:
            return results.number(MEASURE, "variance", material, method.label, scene)

        def share(material: str, method: MethodColumn, scene: str = scene) -> Estimate | str:
            whole = variance(material, method, scene)
            if isinstance(whole, str):
                return whole
            found = results.number(MEASURE, "footprint-share", material, method.label, scene)
            return found if isinstance(found, str) else scaled(found, 100.0)

        rows = material_rows(results, variance, "low", None, "")
        sections.append(Section(f"{scene}: variance of one sample [radiance²]", rows))
        rows = material_rows(results, share, "", None, "")
        sections.append(Section(f"{scene}: share of the footprint [%]", rows))
    if not sections:
        return f"no trial of the measure {MEASURE} has a number"
    return lowest_wins(
        results,
        MEASURE,
        sections,
        name="constant-light",
        title="Variance under constant light, integrated",
        caption=(
            "Variance of one sample of a pixel, as an integral of f²/p over directions at points "
            "of every pixel, the same for all methods: no render takes part. The footprint's share "
            "is the variance of the albedo over a pixel, which no sampler changes: a speed-up at "
            "equal samples "
            f"cannot exceed that of all the rest. {circumstances(results, MEASURE)}"
        ).strip(),
    )
