"""Runs side by side as a page: what moved beyond its interval, what cannot be compared, and each
number over the runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from harness.analysis.history import KEY, Entry, Number, Run, history
from harness.report.page.plain import number
from harness.report.page.shell import whole

SCRIPTS = ("state.js", "elements.js", "unpack.js", "plot.js", "compare.js")


def comparison(folders: Sequence[str | Path]) -> str:
    """The document.

    Raises:
        InputError: fewer than two folders, or no results in one.
    """
    runs, numbers = history(folders)
    names = _names(runs)
    lists = [list(dict.fromkeys(n.key[i] for n in numbers)) for i in range(len(KEY))]
    data = {
        "runs": [_run(run, name) for run, name in zip(runs, names, strict=True)],
        "labels": list(KEY),
        "lists": lists,
        "metrics": (metrics := list(dict.fromkeys(n.metric for n in numbers))),
        "units": (units := list(dict.fromkeys(n.unit for n in numbers))),
        "reasons": (reasons := list(dict.fromkeys(n.why_not for n in numbers if n.why_not))),
        "numbers": [_number(n, lists, metrics, units, reasons) for n in numbers],
        "agreement": _agreement(numbers),
    }
    moved = sum(bool(n.moved) for n in numbers)
    compared = sum(n.moved is not None for n in numbers)
    facts = [
        f"{len(runs)} runs",
        f"{compared} numbers compared",
        f"{moved} moved beyond their intervals",
        f"{len(numbers) - compared} cannot be compared",
    ]
    return whole(f"{names[0]} and {names[-1]}", facts, SCRIPTS, data, plots=True)


def _names(runs: Sequence[Run]) -> list[str]:
    """Of folders, with as many of those above as it takes to tell them apart."""
    for depth in range(1, 6):
        names = ["/".join(run.folder.resolve().parts[-depth:]) for run in runs]
        if len(set(names)) == len(names):
            return names
    return [str(run.folder) for run in runs]


def _run(run: Run, name: str) -> dict[str, Any]:
    return {
        "name": name,
        "suite": run.suite,
        "profile": run.profile,
        "first": run.first,
        "last": run.last,
        "machines": run.machines,
        "versions": run.versions,
    }


def _number(
    one: Number, lists: list[list[Any]], metrics: list[str], units: list[str], reasons: list[str]
) -> list[Any]:
    """``[labels..., metric, unit, reason or -1, moved, change, entries...]``, places in lists."""
    places = [values.index(value) for values, value in zip(lists, one.key, strict=True)]
    why = reasons.index(one.why_not) if one.why_not else -1
    return [
        *places,
        metrics.index(one.metric),
        units.index(one.unit),
        why,
        one.moved,
        number(one.change, 4),
        *(_entry(entry) for entry in one.entries),
    ]


def _entry(entry: Entry | None) -> list[Any] | None:
    if entry is None:
        return None
    ends = [number(v) for v in (entry.value, entry.low, entry.high)]
    return [*ends, entry.trial, entry.status]


def _agreement(numbers: Sequence[Number]) -> list[dict[str, Any]]:
    """By measure and metric: how many intervals overlap, and how wide they are."""
    groups: dict[tuple[str, str], list[Number]] = {}
    for one in numbers:
        if one.moved is not None:
            measure = str(one.key[KEY.index("measure")])
            groups.setdefault((measure, one.metric), []).append(one)
    return [
        {
            "measure": measure,
            "metric": metric,
            "pairs": len(of),
            "moved": sum(bool(one.moved) for one in of),
            "width": number(median(_widths(of)), 3),
            "widest": number(max(_widths(of)), 3),
        }
        for (measure, metric), of in groups.items()
    ]


def _widths(numbers: Sequence[Number]) -> list[float]:
    ends = [e for one in numbers for e in (one.entries[0], one.entries[-1]) if e is not None]
    return [(e.high - e.low) / abs(e.value) if e.value else float("inf") for e in ends]
