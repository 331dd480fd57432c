"""What a suite says, in three sentences made of its numbers: which method, how sure, and whether
a second training would change it."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

from harness.analysis.results import Results
from harness.analysis.seeds import over_training_seeds
from harness.report.page.plain import number
from harness.report.table import Cell, Row, Section, Table
from harness.store.frame import STALE

_CONTESTS = ("table2", "equal-spp", "pdf")
"""Tables whose best method a suite is about, the first that there is."""
_SPEED_UPS = {"table2": "speedup-equal-time", "equal-spp": "speedup-equal-spp"}


@dataclass(frozen=True)
class Contest:
    """A row of a table in which methods compete: of one scene, over all materials or of one."""

    table: Table
    section: Section
    row: Row

    @property
    def ranked(self) -> list[tuple[str, Cell]]:
        """Methods with a number, the best first; not those that are biased, nor ceilings."""
        sign = -1.0 if self.table.best == "high" else 1.0
        pairs = zip(self.table.columns, self.row.cells, strict=True)
        known = [(name, cell) for name, cell in pairs if _known(cell)]
        return sorted(known, key=lambda pair: sign * pair[1].value)


def answer(results: Results, tables: list[Table]) -> dict[str, Any]:
    """``sentences``, and ``means``: dot plots of the rows of means."""
    contests = _contests(tables, [scene for scene in results.frame["scene"].unique() if scene])
    sentences = [_stale(results)] if _stale(results) else []
    if contests:
        sentences += [_which(results, contests), _how_sure(contests), _training(results, contests)]
    else:
        sentences += _without_contest(results, tables)
    return {"sentences": sentences, "means": [_dots(each) for each in _means(tables)]}


def _contests(tables: list[Table], scenes: list[str]) -> list[Contest]:
    """The rows that decide: of each scene of the first table that has any."""
    by_name = {table.name: table for table in tables}
    for name in _CONTESTS:
        if name not in by_name or not by_name[name].best:
            continue
        # Not a paper's own numbers, which may stand below.
        sections = [s for s in by_name[name].sections if s.title in ("", *scenes)]
        if name == "pdf":
            sections = by_name[name].sections
        contests = (_contest(by_name[name], section) for section in sections if section.rows)
        found = [contest for contest in contests if contest.ranked[1:]]
        if found:
            return found if name != "pdf" else found[:1]
    return []


def _contest(table: Table, section: Section) -> Contest:
    means = [row for row in section.rows if row.summary] or section.rows[:1]
    return Contest(table, section, means[-1])


def _which(results: Results, contests: list[Contest]) -> str:
    over = len(results.materials)
    on = f"over {over} materials" if over > 1 else f"on {results.materials[0]}"
    firsts = [each.ranked[0] for each in contests]
    numbers = [" ".join(part for part in cell.parts if part) for _, cell in firsts]
    if contests[0].table.name == "pdf":
        return (
            f"Use {firsts[0][0]}: its density is the closest to the target, KL {numbers[0]} nats "
            f"(mean {on})."
        )
    than = results.baseline or "the baseline"
    as_good = (
        f"as fast as {than} at equal error"
        if contests[0].table.name == "table2"
        else f"the error of {than} at equal samples, inverted"
    )
    if any("materials only" in cell.warning for each in contests for _, cell in each.ranked):
        on += ", or those of them that are resolved"
    mean = f"geometric mean{'s' * (len(contests) > 1)} {on}" if over > 1 else on
    if len({name for name, _ in firsts}) == 1:
        said = ", ".join(
            f"{number}{_in(each, contests)}" for number, each in zip(numbers, contests, strict=True)
        )
        return f"Use {firsts[0][0]}: {said} {as_good} ({mean})."
    said = "; ".join(
        f"{name}{_in(each, contests)}, {number}"
        for (name, _), number, each in zip(firsts, numbers, contests, strict=True)
    )
    return f"Use {said} {as_good} ({mean})."


def _in(contest: Contest, contests: list[Contest]) -> str:
    """Where a contest is held, if there are several."""
    return f" in {contest.section.title}" if len(contests) > 1 else ""


def _how_sure(contests: list[Contest]) -> str:
    said = []
    for each in contests:
        (first, cell), (second, other) = each.ranked[:2]
        number = " ".join(part for part in other.parts if part)
        rows = [row for row in each.section.rows if not row.summary]
        wins = sum(_winner(each, row) == first for row in rows)
        of = f", and it is first on {wins} of {len(rows)} materials" if len(rows) > 1 else ""
        sure = (
            f"{first} is clear of the next, {second} ({number})"
            if _apart(cell, other)
            else f"the lead of {first} over {second} ({number}) is within their intervals"
        )
        said.append(f"{_in(each, contests).strip()} {sure}{of}".strip())
    text = "; ".join(said)
    return f"{text[0].upper()}{text[1:]}."


def _winner(contest: Contest, row: Row) -> str:
    ranked = Contest(contest.table, contest.section, row).ranked
    return ranked[0][0] if ranked else ""


def _training(results: Results, contests: list[Contest]) -> str:
    seeds = sorted(set(results.training.values()))
    if len(seeds) < 2:
        margins = [_margin(each) for each in contests]
        least = min((m for m in margins if math.isfinite(m)), default=math.nan)
        needed = (
            f"; it would have to move a result by a factor of {least:.2f}"
            if math.isfinite(least) and contests[0].table.name != "pdf" else ""
        )  # fmt: skip
        return (
            "Whether a second training would change this is not known here: every method was "
            f"trained once (seed {seeds[0] if seeds else 0}){needed}."
        )
    said = []
    for each in contests:
        first = each.ranked[0][0]
        winners = winners_by_training(results, each.table.name, each.section.title, None)
        won = winners[first]
        where = f"{_in(each, contests).strip()} ".lstrip()
        others = [name for name in winners if name != first]
        then = f" (else {', '.join(others)})" if others else ""
        said.append(f"{where}{first} is first with {won} of {winners.total()} trainings{then}")
    text = "; ".join(said)
    changes = any(" (else " in part for part in said)
    verdict = (
        "A second training may change this" if changes else "A second training does not change this"
    )
    return f"{verdict}: {text}."


def winners_by_training(
    results: Results, table: str, scene: str, material: str | None
) -> Counter[str]:
    """How often each method is first, over the training seeds; of one material or all of them.

    Ceilings do not compete, nor do methods without a number on every material.
    """
    metric = _SPEED_UPS.get(table)
    measure = "equal-time" if metric else "pdf"
    scenes = results.scenes(measure)
    where = scene if scene in scenes else scenes[0] if scenes else ""
    materials = results.materials if material is None else [material]
    logs: dict[int, dict[str, float]] = {}
    for method in results.methods:
        if method.ceiling:
            continue
        found = [
            results.by_training(measure, metric or "kl", each, method.label, where)
            for each in materials
        ]
        for seed in set.intersection(*(set(one) for one in found)) if found else ():
            values = [over_training_seeds({seed: one[seed]}).value for one in found]
            if all(0 < value < math.inf for value in values):
                total = sum(map(math.log, values)) if metric else -sum(values)
                logs.setdefault(seed, {})[method.label] = total
    return Counter(max(of, key=lambda label: of[label]) for of in logs.values())


def _stale(results: Results) -> str:
    rows = results.frame.drop_duplicates("trial")
    old = int((rows["status"] == STALE).sum())
    if not old:
        return ""
    which = f"{old} of {len(rows)}" if old < len(rows) else f"All {old}"
    return (
        f"{which} trials are stale: code that they were measured with has changed since. Their "
        "numbers are shown as they were measured, and marked."
    )


def _without_contest(results: Results, tables: list[Table]) -> list[str]:
    """For suites that no single number decides: what their first table is about."""
    shown = [table for table in tables if table.name != "status"]
    if not shown:
        measured = [m for m in results.frame["measure"].unique() if results.trials(m)]
        if not measured:
            return ["No trial of this suite has given a number yet."]
        return [f"This suite measures {', '.join(measured)}; its plots compare the methods."]
    counted = next((section for section in shown[0].sections if section.title == "all cases"), None)
    said = [f"{shown[0].title}: {shown[0].caption.partition('. ')[0].rstrip('.')}."]
    if counted:
        fewest, label = _extreme(counted, shown[0].columns)
        if fewest:
            said.append(f"{', '.join(fewest)}: {label}.")
    return said


def _extreme(counted: Section, columns: list[str]) -> tuple[list[str], str]:
    """Methods with the fewest failures, and how many these are."""
    rows = {row.label: row for row in counted.rows}
    if "FAIL" not in rows:
        return [], ""
    values = [cell.value or 0.0 for cell in rows["FAIL"].cells]
    least = min(values)
    names = [name for name, value in zip(columns, values, strict=True) if value == least]
    if len(names) == len(columns):
        return ["All methods"], f"{least:.0f} failures each"
    return names, f"the fewest failures, {least:.0f}; the most are {max(values):.0f}"


def _means(tables: list[Table]) -> list[tuple[Table, Section, Row]]:
    """Rows of means of brief sections, of tables in which methods compete."""
    return [
        (table, section, row)
        for table in tables
        if table.name in _CONTESTS and table.best
        for section in table.sections
        if section.brief
        for row in (
            [row for row in section.rows if row.summary]
            or (section.rows if len(section.rows) == 1 else [])
        )
        if sum(_known(cell) for cell in row.cells) > 1
    ]


def _dots(found: tuple[Table, Section, Row]) -> dict[str, Any]:
    table, section, row = found
    return {
        "title": table.title,
        "scene": section.title,
        "row": row.label,
        "best": table.best,
        "table": table.name,
        "dots": [
            {
                "label": name,
                "v": number(cell.value),
                "l": number(cell.low),
                "h": number(cell.high),
                "text": " ".join(part for part in cell.parts if part),
                "note": cell.warning,
                "bold": cell.bold,
            }
            for name, cell in zip(table.columns, row.cells, strict=True)
            if not cell.missing and cell.value is not None and math.isfinite(cell.value)
        ],
        "missing": [
            {"label": name, "why": cell.missing}
            for name, cell in zip(table.columns, row.cells, strict=True)
            if cell.missing
        ],
    }


def _known(cell: Cell) -> bool:
    finite = cell.value is not None and math.isfinite(cell.value)
    return finite and not (cell.missing or cell.ceiling or cell.biased)


def _apart(one: Cell, other: Cell) -> bool:
    if None in (one.low, one.high, other.low, other.high):
        return False
    return one.low > other.high or one.high < other.low


def _margin(contest: Contest) -> float:
    """How far the first is ahead of the second, as a factor."""
    (_, one), (_, other) = contest.ranked[:2]
    if not (one.value > 0 and other.value > 0):
        return math.nan
    return max(one.value / other.value, other.value / one.value)
