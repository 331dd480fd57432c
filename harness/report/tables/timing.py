"""What a method costs: time to render, to fit and to load, and its size."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

from harness.analysis import numbers
from harness.analysis.combine import Estimate, geometric_mean
from harness.analysis.marks import disturbed
from harness.analysis.process_pooling import DISTURBED
from harness.analysis.quantities import nanoseconds_per_sample, scaled
from harness.analysis.results import MethodColumn, Results
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import cell, circumstances, of_earlier_fits

ORDER = 60
_FITTED: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("fit-seconds", "fit", numbers.duration),
    ("load-seconds", "load", numbers.duration),
    ("parameters", "parameters", numbers.count),
    ("size-bytes", "size", numbers.size),
)


def timing(results: Results) -> Table | str:
    """Rows methods; milliseconds per sample per pixel of each scene, then fitting and size."""
    scenes = results.scenes("equal-time")
    fitted = results.has("fit")
    if not scenes and not fitted:
        return "no trial of the measures equal-time or fit is stored"
    columns: list[str] = []
    for scene in scenes:
        where = f" {scene}" if len(scenes) > 1 else ""
        columns += [f"ms per spp{where}", f"ns per sample{where}"]
    if fitted:
        columns += [heading for _, heading, _ in _FITTED]
    rows = []
    for method in results.methods:
        cells = []
        for scene in scenes:
            cells += _render_cells(results, method, scene)
        if fitted:
            cells += [_fit_cell(results, method, metric, said) for metric, _, said in _FITTED]
        rows.append(Row(method.label, cells))
    rounds = results.counts("equal-time", "seconds")
    said = circumstances(
        results,
        "equal-time" if scenes else "fit",
        f"{rounds} interleaved rounds" if rounds else "",
        timed=True,
    )
    sizes = {_resolution(results, trial) for trial in results.trials("equal-time")} - {""}
    image = f" of the {' or '.join(sorted(sizes))} pixels" if sizes else " pixel"
    where = f" Scene: {scenes[0]}." if len(scenes) == 1 else ""
    return Table(
        name="timing",
        title="Time and size",
        caption=(
            f"Steady state: milliseconds for one sample in each{image} of a render, and "
            "nanoseconds for one such sample; medians over rounds, geometric mean over materials, "
            "95% intervals. Fit, load, parameters and size: median over materials."
            f"{where} {said} {of_earlier_fits(results) if fitted else ''}"
        ).strip(),
        corner="method",
        columns=columns,
        sections=[Section("", rows)],
        measures=("equal-time", "fit"),
    )


def _render_cells(results: Results, method: MethodColumn, scene: str) -> list[Cell]:
    """(milliseconds per spp, nanoseconds per sample), geometric means over the materials."""
    milliseconds, nanoseconds = [], []
    for material in results.materials:
        at = (material, method.label, scene)
        per_spp = results.number("equal-time", "seconds-per-spp", *at)
        milliseconds.append(per_spp if isinstance(per_spp, str) else scaled(per_spp, 1e3))
        nanoseconds.append(nanoseconds_per_sample(results, *at))
    marks = {
        m: disturbed(results, ["equal-time"], m, method.label, scene) for m in results.materials
    }
    mark = "; ".join(f"{material}: {said}" for material, said in marks.items() if said)
    return [_marked(_mean(numbers), method, mark) for numbers in (milliseconds, nanoseconds)]


def _marked(number: Estimate | str, method: MethodColumn, mark: str) -> Cell:
    note = number.note if isinstance(number, Estimate) else ""
    return cell(number, method, warning="; ".join(part for part in (mark, note) if part))


def _mean(found: list[Estimate | str]) -> Estimate | str:
    known = [number for number in found if isinstance(number, Estimate)]
    return geometric_mean(known, len(found)) if known else str(found[0])


def _fit_cell(
    results: Results, method: MethodColumn, metric: str, said: Callable[[float], str]
) -> Cell:
    found = [results.number("fit", metric, m, method.label) for m in results.materials]
    known = [number.value for number in found if isinstance(number, Estimate)]
    if not known:
        return Cell(missing=str(found[0]), ceiling=method.ceiling)
    value = median(known)
    waited = (
        []
        if metric != "fit-seconds"
        else [
            material
            for material in results.materials
            if disturbed(results, ["fit"], material, method.label)
        ]
    )
    warning = f"{DISTURBED}: waited for a processor on {', '.join(waited)}" if waited else ""
    return Cell(value, text=said(value), warning=warning, ceiling=method.ceiling)


def _resolution(results: Results, trial: str) -> str:
    measure = results.stored(trial).trial.get("measure")
    side = measure["settings"].get("resolution") if isinstance(measure, dict) else None
    return f"{side} × {side}" if side else ""
