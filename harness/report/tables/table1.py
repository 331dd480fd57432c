"""Where the time goes: NeuSample's Table 1, and its own figures if the suite names the table."""

from __future__ import annotations

from harness.analysis import numbers
from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.marks import disturbed
from harness.analysis.quantities import scaled
from harness.analysis.results import MethodColumn, Results
from harness.report.published.neusample import Published, neusample
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import asked_for, cell, circumstances

ORDER = 10
MEASURE = "cost"
_ROWS = ("rendering", "sampling")
"""Of the paper's table."""
_PARTS = ("sampling", "material", "rest")
_TIMES = (
    ("rendering ms/spp", "seconds-per-spp", 1e3),
    *((f"{part} ms/spp", f"{part}-seconds-per-spp", 1e3) for part in _PARTS),
    *((f"{part} %", f"{part}-share", 1e2) for part in _PARTS),
    ("s per M samples", "seconds-per-million-samples", 1.0),
    ("s per M pdfs", "seconds-per-million-pdf", 1.0),
)
_ONCE = (
    ("fit: data", "fit-data-seconds", numbers.duration),
    ("fit: optimise", "fit-optimise-seconds", numbers.duration),
    ("load", "load-seconds", numbers.duration),
    ("compile", "compile-seconds", numbers.duration),
    ("size", "size-bytes", numbers.size),
    ("peak memory", "peak-bytes", numbers.size),
)
_COUNTS = (
    ("rays", "rays"),
    ("shading points", "shading-points"),
    ("sample calls", "sample-calls"),
    ("pdf calls", "pdf-calls"),
    ("eval calls", "eval-calls"),
)
_LEGEND = (
    "Sampling is the method's sample and pdf, material the evaluation of the BSDF, rest all "
    "else; brackets: 95% intervals. ‡ a timing that was disturbed, or a number of some materials "
    "only.",
)


def table1(results: Results) -> Table | str:
    """Rows methods; a section for each scene: times and shares, fit, memory and counts."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    paper = neusample() if asked_for(results, "table1") else None
    published = [f"{paper.short}: {row} {paper.table1['unit']}" for row in _ROWS] if paper else []
    columns = [
        *(name for name, _, _ in _TIMES),
        *published,
        *(name for name, _, _ in _ONCE),
        *(name for name, _ in _COUNTS),
    ]
    scenes = results.scenes(MEASURE)
    sections = [
        Section(
            scene if len(scenes) > 1 else "",
            [Row(m.label, _cells(results, m, scene, paper)) for m in results.methods],
        )
        for scene in scenes
    ]
    rounds, processes = results.counts(MEASURE, "seconds"), results.counts(MEASURE, "processes")
    taken = f"{rounds} interleaved rounds" if rounds else ""
    if processes:
        taken += f" in {processes} processes, geometric means over these"
    said = circumstances(results, MEASURE, taken, timed=True)
    where = f" Scene: {scenes[0]}." if len(scenes) == 1 else ""
    return Table(
        name="table1",
        title="Where the time goes",
        caption=(
            "Seconds of one sample in each pixel of a render, and their parts; medians over "
            f"rounds, geometric means over materials ({', '.join(results.materials)}). Fit, load, "
            f"compile, size and memory are before the first sample; counts are per spp.{where} "
            f"{said}"
        ).strip(),
        corner="method",
        columns=columns,
        sections=sections,
        legend=[
            *_LEGEND,
            *(_about(paper) if paper else ()),
        ],
        measures=(MEASURE,),
    )


def _about(paper: Published) -> list[str]:
    return [
        f"{paper.short}: published figures, {paper.table1['about']}; another machine, "
        f"renderer and material, so compare shares and not seconds. {paper.citation}."
    ]


def _cells(
    results: Results, method: MethodColumn, scene: str, paper: Published | None
) -> list[Cell]:
    marks = {m: disturbed(results, [MEASURE], m, method.label, scene) for m in results.materials}
    mark = "; ".join(f"{material}: {said}" for material, said in marks.items() if said)
    cells = []
    for _, metric, factor in _TIMES:
        number = _mean(results, metric, method.label, scene)
        if isinstance(number, Estimate):
            warning = "; ".join(part for part in (mark, number.note) if part)
            cells.append(cell(scaled(number, factor), method, warning=warning))
        else:
            cells.append(cell(number, method))
    for row in _ROWS if paper else ():
        value = paper.table1[row].get(method.name)
        cells.append(
            Cell(missing=f"not in {paper.table1['number']} of {paper.short}")
            if value is None
            else Cell(value, text=f"{value:.4f}")
        )
    for _, metric, say in _ONCE:
        number = _mean(results, metric, method.label, scene)
        cells.append(
            Cell(missing=number, ceiling=method.ceiling)
            if isinstance(number, str)
            else Cell(
                number.value, number.low, number.high, text=say(number.value),
                warning=number.note, ceiling=method.ceiling,
            )
        )  # fmt: skip
    for _, metric in _COUNTS:
        number = _mean(results, metric, method.label, scene)
        cells.append(
            Cell(missing=number, ceiling=method.ceiling)
            if isinstance(number, str)
            else Cell(number.value, text=_count(number.value), ceiling=method.ceiling)
        )
    return cells


def _count(value: float) -> str:
    """A count per spp, which may be a fraction: one call serves many samples."""
    return numbers.count(value) if value == 0 or value >= 10 else f"{value:.2g}"


def _mean(results: Results, metric: str, method: str, scene: str) -> Estimate | str:
    """Over materials: geometric; the plain mean where a number is not above zero."""
    found = [results.number(MEASURE, metric, m, method, scene) for m in results.materials]
    known = [number for number in found if isinstance(number, Estimate)]
    if not known:
        return str(found[0])
    if len(known) == 1 == len(found):
        return known[0]
    if all(number.value > 0 for number in known):
        return geometric_mean(known, len(found))
    note = (
        f"mean over {len(known)} of {len(found)} materials only" if len(known) < len(found) else ""
    )
    return Estimate(sum(number.value for number in known) / len(known), note=note)
