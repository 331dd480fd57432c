"""The heat map of numerical stability as a table: rows hard cases, columns methods."""

from __future__ import annotations

from harness.analysis import numbers
from harness.analysis.results import Results
from harness.analysis.verdicts import MEASURE, CaseRow, Entry, case_rows, false_alarm, groups
from harness.report.table import Cell, Row, Section, Table
from harness.report.tables.common import circumstances

ORDER = 90
_WORDS = {"pass": "pass", "degraded": "degraded", "fail": "FAIL"}
_COUNTED = (("pass", "pass"), ("degraded", "degraded"), ("fail", "FAIL"), ("skip", "no answer"))
_LEGEND = (
    "pass: every property holds. degraded: correct, yet unable by construction to do the case "
    "well. FAIL: wrong (its density, its samples or its weights), or it raised an exception."
)
_NUMBERS = (
    "eff: the share of the samples that count, 1 / (1 + χ²) of the weights f/p; degraded "
    "below 1 %, or where weights too large to be tested bring over 5 % of the albedo. invalid: "
    "samples off the disk; degraded above half. tail: Hill's index of the largest weights; "
    "degraded below 2, where the variance is infinite."
)


def stability(results: Results) -> Table | str:
    """A section per group of cases; cells pass, degraded with its number, FAIL or a dagger."""
    if not results.has(MEASURE):
        return f"no trial of the measure {MEASURE} is stored"
    rows = case_rows(results)
    sections = [
        Section(
            group,
            [Row(r.name, _cells(results, r), about=r.about, material=r.material) for r in members],
        )
        for group, members in groups(rows).items()
    ]
    methods = [method.label for method in results.methods]
    chance = false_alarm(results)
    said_chance = numbers.plain(chance, numbers.decimals_for(chance) - 1)
    said = circumstances(results, MEASURE, f"{len(rows)} cases")
    return Table(
        name=MEASURE,
        title="Numerical stability",
        caption=(
            "Each method, fitted to a hard material or asked a hard question, against what a "
            "correct sampler must hold to. That correct methods fail anywhere in this table by "
            f"chance has a probability of at most {said_chance}. {said}"
        ).strip(),
        corner="case",
        columns=methods,
        sections=[Section("all cases", _summary(rows, len(methods))), *sections],
        legend=[_LEGEND, _NUMBERS],
        measures=(MEASURE,),
    )


def _cells(results: Results, row: CaseRow) -> list[Cell]:
    pairs = zip(results.methods, row.entries, strict=True)
    return [_cell(entry, f"{row.name}, {method.label}") for method, entry in pairs]


def _cell(entry: Entry, where: str) -> Cell:
    if entry.verdict == "skip":
        return Cell(missing=entry.reason)
    text = entry.short or _WORDS[entry.verdict]
    warning = f"{where}: {entry.reason}" if entry.reason else ""
    return Cell(entry.level, text=text, warning=warning, shade=entry.verdict)


def _summary(rows: list[CaseRow], methods: int) -> list[Row]:
    """How many cases each method passes, does badly, fails, has no answer for."""
    found = []
    for verdict, label in _COUNTED:
        counts = [sum(row.entries[i].verdict == verdict for row in rows) for i in range(methods)]
        # A count of none is not coloured: it is no failure.
        shades = [verdict if count and verdict in _WORDS else "" for count in counts]
        cells = [
            Cell(float(count), text=str(count), shade=shade)
            for count, shade in zip(counts, shades, strict=True)
        ]
        found.append(Row(label, cells))
    return found
