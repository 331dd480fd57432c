"""Which stored numbers the code beside them would not give any more, told from source alone."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from harness.analysis.renew import OUTDATED, outdated
from harness.core.paths import ROOT
from harness.identity.digests import Digests, Part
from harness.identity.named_files import digest_of
from harness.identity.ours import digests
from harness.identity.verdict import (
    ADAPTER,
    BASELINE,
    SOURCES,
    TRAINING,
    changed_units,
    judge,
    short,
)
from harness.store import code
from harness.store.folder import ResultsFolder
from harness.store.stored import Stored


@dataclass
class Changed:
    """What other code has to do with stored trials, by key.

    ``stale``: why numbers do not hold any more. ``earlier``: fits that came with the harness, whose
    state is data, and whose seconds and loss are those of an earlier version of the code.
    """

    stale: dict[str, str] = field(default_factory=dict)
    earlier: frozenset[str] = frozenset()


def changed(results: ResultsFolder, trials: Mapping[str, Stored]) -> Changed:
    """Those of ``trials`` whose code has changed; nothing is computed anew.

    A change that a run found to move no number (``equivalent``) does not count. A user's own
    adapter or measure, which is not part of the project, is compared by a run alone.
    """
    known = digests()
    equal: dict[tuple[str, str, str], set[str]] = {}
    for part, old, new, shared in code.equivalents(results):
        equal.setdefault((part, old, new), set()).add(shared)
    units: dict[str, Mapping[str, str]] = {}
    # Most trials begin where many others do.
    alike: dict[tuple[str, str], dict[str, str]] = {}
    now: dict[str, dict[str, str]] = {}
    for key, trial in trials.items():
        begun = (repr(trial.entries), repr(list(trial.parts)))
        if begun not in alike:
            alike[begun] = _current(known, trial, units)
        now[key] = alike[begun]

    @cache
    def details(part: str, old: str, new: str) -> list[str]:
        before, after = code.units(results, old), units.get(new)
        return changed_units(before, short(after)) if before and after else []

    adapters = {
        trial.parts[ADAPTER]: now[key][ADAPTER]
        for key, trial in trials.items()
        if ADAPTER in now[key] and ADAPTER in trial.parts
    }
    found, earlier = {}, set()
    for key, trial in trials.items():
        base = trial.parts.get(BASELINE, "")
        current = now[key] | ({BASELINE: adapters[base]} if base in adapters else {})
        before = {part: digest for part, digest in trial.parts.items() if part in current}
        # A time stands only where the work that is timed is the same too.
        enough = {"work"} if _timed(trial) else {"work", "numbers"}

        def same(part: str, old: str, new: str, enough: set[str] = enough) -> bool:
            part = ADAPTER if part == BASELINE else part
            return bool(equal.get((part, old, new), set()) & enough)

        verdict = judge(before, current, same, details)
        if trial.shipped and not verdict.stands:
            earlier.add(key)
        elif verdict.stands and outdated(trial):
            verdict = OUTDATED
        if trial.status in ("ok", "nonfinite") and not (verdict.stands or key in earlier):
            found[key] = verdict.sentence
    return Changed(found, frozenset(earlier))


def said_of_earlier(count: int) -> str:
    """A sentence about so many of :attr:`Changed.earlier`; "" about none."""
    if count == 0:
        return ""
    fits, its = ("1 fit", "its") if count == 1 else (f"{count} fits", "their")
    return (
        f"{fits} shipped with the harness, fitted by an earlier version of the code: {its} seconds "
        "are those of that version"
    )


def in_few_words(reason: str) -> str:
    """A reason for being stale without the places in the code, of which there may be hundreds."""
    return re.sub(r" \([^()]*\)", "", reason) if reason.startswith("stale:") else reason


def changed_files(plan: Mapping[str, Any]) -> dict[str, str]:
    """Why, for each planned trial that names a file which is another now; see harness.suite.named.

    A file that is not there any more says nothing: results may be read where it never was.
    """
    found: dict[str, str] = {}
    for kind, labels in (plan.get("files") or {}).items():
        changed = {label: _changed(files) for label, files in labels.items()}
        for row in plan["trials"]:
            if names := changed.get(row[kind]):
                reason = f"stale: a file of the {kind} changed ({', '.join(names)})"
                found.setdefault(row["trial"], reason)
    return found


def _changed(files: Mapping[str, str]) -> list[str]:
    places = {name: ROOT / name for name in files}  # an absolute name stays as it is
    return [
        name
        for name, kept in files.items()
        if places[name].is_file() and digest_of([places[name]]).digest != kept
    ]


def _timed(trial: Stored) -> bool:
    """Whether the numbers are times of a machine."""
    return "machine" in trial.trial and trial.labels.get("measure") != "fit"


def _current(known: Digests, trial: Stored, units: dict[str, Mapping[str, str]]) -> dict[str, str]:
    """Digests of the trial's parts that are source code of the project."""
    parts = {name: Part(*map(tuple, about)) for name, about in trial.entries.items()}
    tops = {
        entry.partition(":")[0].partition(".")[0] for p in parts.values() for entry in p.entries
    }
    if not tops <= known.tree.roots.keys():
        return {}  # a user's own code, of which only a run knows where it is
    apart = {TRAINING: (ADAPTER, "fit")} if TRAINING in trial.parts else None
    try:
        found = known.of(parts, apart)
    except KeyError:
        # What it began with is gone; no digest equals that of nothing.
        return dict.fromkeys((part for part in SOURCES if part in trial.parts), "")
    units.update({source.digest: source.units for source in found.values()})
    return {name: source.digest for name, source in found.items()}
