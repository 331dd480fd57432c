"""What the measure ``stability`` stored, as the table and the figure show it: case by method.

Each trial's document ``findings`` holds the cases of the catalogue that its material stands for,
with their place in the catalogue, their group, and what every property said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from harness.analysis import numbers
from harness.analysis.results import NO_TRIAL, Results

MEASURE = "stability"
FINDINGS = "findings"
WORST_FIRST = ("fail", "degraded", "pass", "skip")
_BROKEN = ("error", "nonfinite")
"""Statuses of a trial in which the adapter itself failed, in fitting or in measuring."""
_NOWHERE = "cases unknown"
"""Group of a material for which no method has a trial, so that its cases are not known."""


@dataclass(frozen=True)
class Entry:
    """One method in one case.

    ``verdict`` is one of :data:`WORST_FIRST`, ``short`` what fits into a cell ("eff 0.31 %"),
    ``reason`` the findings behind a verdict other than "pass".
    """

    verdict: str
    short: str = ""
    reason: str = ""

    @property
    def level(self) -> float:
        """0 pass, 1 degraded, 2 fail; nan where there is no answer."""
        return {"pass": 0.0, "degraded": 1.0, "fail": 2.0}.get(self.verdict, math.nan)


@dataclass(frozen=True)
class CaseRow:
    """One case with an entry for each method, in the order of ``Results.methods``."""

    name: str
    group: str
    about: str
    entries: list[Entry]
    material: str = ""


def case_rows(results: Results) -> list[CaseRow]:
    """All cases that the suite's materials stand for, in the order of the catalogue."""
    known: dict[str, dict[str, Any]] = {}
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    unknown = []
    for material in results.materials:
        trials = results.trials(MEASURE, material)
        for trial in trials:
            method = results.stored(trial).labels["method"]
            for case in _stored(results, trial)["cases"]:
                known.setdefault(case["case"], {**case, "material": material})
                found.setdefault((case["case"], method), []).append(case)
        if not trials and results.rows(MEASURE, material):
            unknown.append(material)
    rows = [
        CaseRow(
            case["case"],
            case["group"],
            case["about"],
            [
                _worst(results, case["material"], m.label, found.get((case["case"], m.label), []))
                for m in results.methods
            ],
            case["material"],
        )
        for case in sorted(known.values(), key=lambda case: case["position"])
    ]
    for material in unknown:
        entries = [_worst(results, material, m.label, []) for m in results.methods]
        rows.append(CaseRow(material, _NOWHERE, "", entries, material))
    return rows


def false_alarm(results: Results) -> float:
    r"""Probability, at most, that correct methods fail anywhere in what is stored.

    .. math:: 1 - \prod_k (1 - \alpha_k)

    over the cases of all trials, with the level of each as it was measured.
    """
    kept = 0.0
    for trial in results.trials(MEASURE):
        stored = _stored(results, trial)
        kept += len(stored["cases"]) * math.log1p(-float(stored["case_alarm"]))
    return -math.expm1(kept)


def groups(rows: list[CaseRow]) -> dict[str, list[CaseRow]]:
    """The rows by group; groups in the order in which they appear."""
    found: dict[str, list[CaseRow]] = {}
    for row in rows:
        found.setdefault(row.group, []).append(row)
    return found


def _stored(results: Results, trial: str) -> dict[str, Any]:
    return results.stored(trial).documents[FINDINGS]


def _worst(results: Results, material: str, method: str, cases: list[dict[str, Any]]) -> Entry:
    """The worst over seeds, of which one that broke down is a failure."""
    entries = [_entry(case) for case in cases]
    entries += _without_findings(results, material, method)
    if not entries:
        return Entry("skip", reason=NO_TRIAL)
    return min(entries, key=lambda entry: WORST_FIRST.index(entry.verdict))


def _entry(case: dict[str, Any]) -> Entry:
    verdict = case["verdict"]
    behind = [finding for finding in case["findings"] if finding["verdict"] == verdict]
    if verdict == "pass":
        return Entry(verdict)
    reason = "; ".join(dict.fromkeys(f"{f['property']}: {f['text']}" for f in behind))
    if verdict == "fail" and behind and behind[0]["worst"]:
        worst = ", ".join(f"{name} {value}" for name, value in behind[0]["worst"].items())
        reason += f"; worst input: {worst}"
    return Entry(verdict, _short(behind) if verdict == "degraded" else "", reason)


def _without_findings(results: Results, material: str, method: str) -> Iterable[Entry]:
    """An entry for each seed whose trial, or the fit that it needs, did not end well."""
    fits = {results.training[row["trial"]]: row for row in results.rows("fit", material, method)}
    for row in results.rows(MEASURE, material, method):
        if row["status"] == "ok":
            continue
        fit = fits.get(results.training[row["trial"]])
        at_fault = fit if fit is not None and fit["status"] in _BROKEN else row
        reason = " ".join(str(at_fault["reason"]).split())
        verdict = "fail" if at_fault["status"] in _BROKEN else "skip"
        where = "fit " if at_fault is fit else ""
        said = f"{where}{at_fault['status']}"
        yield Entry(verdict, reason=f"{said}: {reason}" if reason else said)


# --- numbers in a cell -------------------------------------------------------------------------


def _share(value: float) -> str:
    """A share in two digits, as a percentage unless that takes a power of ten, too."""
    if 0 < value < 1e-5:
        return numbers.plain(value, numbers.decimals_for(value) - 1)
    percent = 100.0 * value
    places = 1 - math.floor(math.log10(percent)) if 0 < percent < math.inf else 0
    return f"{numbers.plain(percent, max(0, places))} %"


def _plain(value: float) -> str:
    return numbers.plain(value, 2)


_NUMBERS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("state", "refused", _share),
    ("weights", "eff", _share),
    ("invalid", "invalid", _share),
    ("coverage", "lost", _share),
    ("tail-index", "tail", _plain),
)
"""(property, what its number is called in a cell, how it is written); the first degraded
property of this order speaks for the cell."""


def _short(findings: list[dict[str, Any]]) -> str:
    measured = {f["property"]: float(f["number"]) for f in findings if f["number"] is not None}
    for name, word, said in _NUMBERS:
        if name in measured:
            return f"{word} {said(measured[name])}"
    for name, value in measured.items():
        return f"{name} {numbers.plain(value, max(0, numbers.decimals_for(value)))}"
    return ""
