"""The numbers of several runs side by side, in the order given: what moved, what cannot be said.

A number *moved* between the first run and the last if their 95 % intervals have no point in
common. It can be compared only if both have an interval of some width, of different measurements,
and, for a time, of one machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.analysis.results import Results
from harness.core.protocol.errors import InputError
from harness.store.stored import LABELS

KEY = tuple(label for label in LABELS if label != "suite")


@dataclass(frozen=True)
class Entry:
    """One run's value of a number; bounds are nan where it has none."""

    value: float
    low: float
    high: float
    trial: str
    started: str
    machine: str
    status: str

    @property
    def has_interval(self) -> bool:
        """Whether it has an interval of some width: a definition has none."""
        return self.low < self.high


@dataclass(frozen=True)
class Number:
    """One number over all runs; None where a run does not have it.

    ``why_not`` says why first and last cannot be compared; ``moved`` is None then. ``change`` is
    last over first.
    """

    key: tuple[Any, ...]
    metric: str
    unit: str
    entries: tuple[Entry | None, ...]
    why_not: str
    moved: bool | None
    change: float


@dataclass(frozen=True)
class Run:
    """What a run is called, and when and where it was measured."""

    folder: Path
    suite: str
    profile: str
    first: str
    last: str
    machines: tuple[str, ...]
    versions: tuple[str, ...]


def history(folders: Sequence[str | Path]) -> tuple[list[Run], list[Number]]:
    """All numbers that any of the runs has, in the order of the first that has them.

    Raises:
        InputError: fewer than two folders, or no results in one.
    """
    if len(folders) < 2:
        raise InputError("compare: expected two results folders or more")
    runs, found = [], {}
    for i, folder in enumerate(folders):
        results = Results.load(folder)
        runs.append(_run(Path(folder), results))
        for row in results.frame.to_dict("records"):
            if not row["metric"]:
                continue
            key = (*(row[label] for label in KEY), row["metric"])
            entries, _ = found.setdefault(key, ([None] * len(folders), row["unit"]))
            entries[i] = _entry(results, row)
    return runs, [_number(key, unit, tuple(entries)) for key, (entries, unit) in found.items()]


def _run(folder: Path, results: Results) -> Run:
    trials = list(results.found.values())
    dates = sorted(trial.started for trial in trials if trial.started)
    machines = dict.fromkeys(_words(t.environment.get("machine")) for t in trials)
    versions = dict.fromkeys(_words(t.environment.get("versions")) for t in trials)
    return Run(
        folder,
        str(results.plan.get("suite") or folder.name),
        results.profile,
        dates[0] if dates else "",
        dates[-1] if dates else "",
        tuple(name for name in machines if name),
        tuple(name for name in versions if name),
    )


def _words(data: Any) -> str:
    if isinstance(data, dict):
        return ", ".join(f"{key} {value}" for key, value in data.items() if value)
    return str(data or "")


def _entry(results: Results, row: dict[str, Any]) -> Entry:
    stored = results.stored(row["trial"])
    return Entry(
        row["value"],
        row["ci_low"],
        row["ci_high"],
        row["trial"],
        stored.started,
        _words(stored.trial.get("machine")),
        row["status"],
    )


def _number(key: tuple[Any, ...], unit: str, entries: tuple[Entry | None, ...]) -> Number:
    first, last = entries[0], entries[-1]
    why = _why_not(first, last)
    moved = None if why else first.high < last.low or last.high < first.low
    change = last.value / first.value if first and last and first.value else math.nan
    return Number(key[:-1], key[-1], unit, entries, why, moved, change)


def _why_not(first: Entry | None, last: Entry | None) -> str:
    if first is None or last is None:
        return "only the last run has it" if first is None else "only the first run has it"
    for which, entry in (("first", first), ("last", last)):
        if entry.status not in ("ok", "stale"):
            return f"{entry.status} in the {which} run"
    if first.trial == last.trial and first.started == last.started:
        return "of one and the same measurement"
    if first.machine != last.machine:
        return "times taken on different machines"
    if not (first.has_interval and last.has_interval):
        return "no interval"
    return ""
