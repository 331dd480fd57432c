"""After how many samples a method has paid for what it costs before the first."""

from __future__ import annotations

import math
from collections.abc import Callable

from harness.analysis import numbers
from harness.analysis.bias import bias_warnings
from harness.analysis.breakeven import TIMES, CostLine, Costs, costs, timed_scenes
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import circumstances, of_earlier_fits
from harness.stats.crossing import Crossing

ORDER = 70
Warnings = Callable[[str, str, str], str]
"""(material, method, scene) -> what makes the method's number doubtful."""
FLOOR = "cosine"
"""The other rival, beside the suite's baseline."""
_LEGEND = (
    "A number is that of samples of {reference} (over all pixels) from which on the method is "
    "ahead; 0: from the start; until: ahead only up to there, its start being cheaper and its "
    "samples costlier; never: behind from the start, with the seconds per sample of equal quality "
    "over the rival's. Brackets: 95% interval, ∞ where it includes never.",
    "Total time to an error: load and fit, then samples × seconds per sample; a method of less "
    "variance needs fewer samples.",
)


def breakeven(results: Results) -> Table | str:
    """Sections: rival, scene, fitted here or shipped; rows materials, columns methods."""
    scenes = timed_scenes(results)
    if not scenes:
        return f"no trial of the measures {' or '.join(TIMES)} is stored"
    rivals = _rivals(results)
    if not rivals:
        return "the suite has no baseline to break even with"
    warnings = bias_warnings(results)
    sections = []
    for shipped in (False, True):
        for scene in scenes:
            found = {m: costs(results, m, scene, shipped) for m in results.materials}
            for rival in rivals:
                rows = [
                    Row(m, [_cell(c, method, rival, warnings) for method in results.methods])
                    for m, c in found.items()
                ]
                where = f"{scene}, " if len(scenes) > 1 else ""
                how = "shipped with its fit" if shipped else "fitted here"
                brief = not shipped and rival == rivals[0]
                sections.append(Section(f"{where}against {rival}, {how}", rows, brief))
    measure = next(measure for measure in TIMES if results.has(measure))
    said = circumstances(results, measure, timed=True)
    return Table(
        name="breakeven",
        title="Break-even",
        caption=(
            "Samples after which a method's total time to the same error is less than its rival's."
            f"{f' Scene: {scenes[0]}.' if len(scenes) == 1 else ''} {said} "
            f"{of_earlier_fits(results)}"
        ).strip(),
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        legend=[line.format(reference=results.baseline) for line in _LEGEND],
        measures=(*TIMES, "equal-spp", "fit"),
    )


def _rivals(results: Results) -> list[str]:
    """Labels of the baseline and of the floor, those that there are."""
    floor = [m.label for m in results.methods if m.name == FLOOR]
    return list(dict.fromkeys(label for label in (results.baseline, *floor[:1]) if label))


def _cell(found: Costs | str, method: MethodColumn, rival: str, warnings: Warnings) -> Cell:
    if isinstance(found, str):
        return Cell(missing=found, ceiling=method.ceiling)
    for label in (method.label, rival):
        if label in found.missing:
            return Cell(missing=found.missing[label], ceiling=method.ceiling)
    if method.label == rival:
        return Cell(text="·", ceiling=method.ceiling)
    line, other = found.lines[method.label], found.lines[rival]
    crossing = line.against(other)
    notes = (
        warnings(found.material, method.label, found.scene),
        line.mark,
        f"{rival}: {other.mark}" if other.mark else "",
    )
    return Cell(
        crossing.at,
        crossing.low,
        crossing.high,
        text=words(crossing, line, other),
        warning="; ".join(note for note in notes if note),
        ceiling=method.ceiling,
    )


def words(crossing: Crossing, line: CostLine, rival: CostLine) -> str:
    """A crossing as a cell says it."""
    low, high = (_count(v) for v in (crossing.low, crossing.high))
    interval = "" if crossing.low == crossing.high else f" [{low}, {high}]"
    if crossing.kind == "never":
        times = numbers.plain(float(line.slope[0] / rival.slope[0]), 2)
        return f"never ({times}× a sample){interval}"
    before = "until " if crossing.kind == "until" else ""
    return f"{before}{_count(crossing.at)}{interval}"


def _count(samples: float) -> str:
    return "∞" if math.isinf(samples) else numbers.count(samples)
