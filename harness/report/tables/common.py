"""What the tables share: cells from estimates, rows of materials, and the circumstances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from harness.analysis.combine import Estimate
from harness.analysis.results import MethodColumn, Results
from harness.analysis.validity import said_of_earlier
from harness.report.table import Cell, Row, Section, Table, embolden

Number = Callable[[str, MethodColumn], Estimate | str]
"""(material, method) -> the number, or the reason why there is none."""
Mean = Callable[[list[Estimate], int], Estimate]

BOLD_LEGEND = (
    "Bold: the best of its row, where its interval lies clear of every other's. Brackets: 95% "
    "intervals. † no number, ‡ a number to be read with its note; neither wins."
)
CEILING_LEGEND = (
    "tabulated (italic) is the ceiling: too slow and too large to be used, so it does not compete."
)


def asked_for(results: Results, table: str) -> bool:
    """Whether the suite names the table: a paper's own figures are shown in no other."""
    return table in (results.wanted("tables") or ())


def cell(
    number: Estimate | str,
    method: MethodColumn,
    suffix: str = "",
    warning: str = "",
    biased: bool = False,
) -> Cell:
    """A number, or a dagger with its reason."""
    if isinstance(number, str):
        return Cell(missing=number, ceiling=method.ceiling)
    return Cell(
        number.value,
        number.low,
        number.high,
        suffix=suffix,
        warning=warning or number.note,
        biased=biased,
        ceiling=method.ceiling,
    )


def material_rows(
    results: Results,
    number: Number,
    best: str,
    mean: Mean | None,
    mean_label: str,
    suffix: str = "",
    warning: Callable[[str, MethodColumn], str] = lambda material, method: "",
    biased: Callable[[str, MethodColumn], bool] = lambda material, method: False,
) -> list[Row]:
    """A row per material with a cell per method, and the row of means below."""
    rows = []
    for material in results.materials:
        cells = [
            cell(number(material, m), m, suffix, warning(material, m), biased(material, m))
            for m in results.methods
        ]
        rows.append(Row(material, embolden(cells, best)))
    if mean is None or len(results.materials) < 2:
        return rows
    means = [_mean_cell(results, number, m, mean, suffix, warning, biased) for m in results.methods]
    return [*rows, Row(mean_label, embolden(means, best), summary=True)]


def lowest_wins(
    results: Results, measure: str, sections: list[Section], name: str, title: str, caption: str
) -> Table:
    """Materials against methods by one measure, the lowest number of a row being the best."""
    return Table(
        name=name,
        title=title,
        caption=caption,
        corner="material",
        columns=[method.label for method in results.methods],
        sections=sections,
        best="low",
        legend=legend(results),
        measures=(measure,),
    )


def as_baseline(text: str, method: MethodColumn) -> Cell:
    """The reference of a ratio: one by definition, without an interval."""
    return Cell(1.0, 1.0, 1.0, text=text, ceiling=method.ceiling)


def legend(results: Results) -> list[str]:
    """The lines under a table whose rows are contests."""
    return [BOLD_LEGEND] + [CEILING_LEGEND] * any(m.ceiling for m in results.methods)


def circumstances(results: Results, measure: str, *counts: str, timed: bool = False) -> str:
    """Profile, seeds, counts and (for times) machine of a measure, as caption sentences."""
    said = [part for part in counts if part]
    rows = results.frame[results.frame["measure"] == measure]
    seeds = len(set(rows["seed"]))
    fits = len({results.training.get(trial, 0) for trial in rows["trial"]})
    if fits > 1:
        said.append(f"{fits} training seeds")
    if seeds > fits:
        said.append(f"{seeds} seeds")
    if results.profile:
        said.append(f"profile {results.profile}")
    text = "; ".join(said)
    text = f"{text[0].upper()}{text[1:]}." if text else ""
    if timed:
        machines = sorted({machine(results, trial) for trial in results.trials(measure)} - {""})
        if machines:
            text += f" Machine: {'; '.join(machines)}."
        if len(machines) > 1:
            text += " Times of different machines are not to be compared."
    old, count = results.stale(measure)
    if old:
        which = f"{old} of {count}" if old < count else f"All {count}"
        text += f" {which} trials are stale: code that they were measured with has changed since."
    return text.strip()


def of_earlier_fits(results: Results) -> str:
    """A sentence of a caption about shipped fits by an earlier version of the code; "" if none."""
    said = said_of_earlier(len(results.earlier))
    return f"{said}." if said else ""


def machine(results: Results, trial: str) -> str:
    """The machine a trial ran on, in words; "" if not stored."""
    return machine_words(results.stored(trial).trial.get("machine", ""))


def machine_words(machine: Any) -> str:
    """A machine's description as one line: processor, cores, graphics card."""
    if not isinstance(machine, dict):
        return str(machine or "")
    words = {**machine, "cores": f"{machine['cores']} cores"} if "cores" in machine else machine
    return ", ".join(str(word) for word in words.values() if word)


def _left_out(missing: dict[str, str]) -> list[str]:
    """Which materials a mean is without, by the kind of reason."""
    reasons: dict[str, list[str]] = {}
    for material, why in missing.items():
        reasons.setdefault(why.partition(":")[0], []).append(material)
    return [f"without {', '.join(where)} ({why})" for why, where in reasons.items()]


def _mean_cell(
    results: Results,
    number: Number,
    method: MethodColumn,
    mean: Mean,
    suffix: str,
    warning: Callable[[str, MethodColumn], str],
    biased: Callable[[str, MethodColumn], bool],
) -> Cell:
    numbers = {material: number(material, method) for material in results.materials}
    known = {m: n for m, n in numbers.items() if isinstance(n, Estimate)}
    if not known:
        return Cell(missing="no number for any material", ceiling=method.ceiling)
    try:
        combined = mean(list(known.values()), len(numbers))
    except ValueError as error:
        return Cell(missing=str(error), ceiling=method.ceiling)
    doubtful: dict[str, list[str]] = {}
    for material in known:
        # A warning begins with what is wrong: biased, disturbed.
        for part in filter(None, warning(material, method).split("; ")):
            doubtful.setdefault(part.partition(":")[0], []).append(material)
    said = [f"{what} on {', '.join(where)}" for what, where in doubtful.items()]
    said += _left_out({m: n for m, n in numbers.items() if isinstance(n, str)})
    said_of_it = "; ".join(filter(None, (combined.note, *said)))
    return cell(combined, method, suffix, said_of_it, any(biased(m, method) for m in known))
