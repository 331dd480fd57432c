"""Results of several folders in one: of a suite that ran in parts, or in several places."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.store import code, files
from harness.store.database import FILE, file_of
from harness.store.folder import ResultsFolder
from harness.store.lock import LOCK, claim, locked
from harness.store.stored import DAMAGED, LABELS, Stored

_SAME = ("suite", "profile", "device", "baseline")
"""What plans have to agree in."""
_RANK = ("ok", "unsupported", "nonfinite", "timeout", "error", "skipped")
"""Of two results of one trial the one that comes first is taken."""


@dataclass
class Merged:
    """``taken`` trials of each folder; ``conflicts`` are trials whose numbers differ and are no
    times, by folder those that were left; ``elsewhere`` counts those of each further machine."""

    taken: dict[Path, int] = field(default_factory=dict)
    conflicts: dict[Path, list[str]] = field(default_factory=dict)
    elsewhere: dict[str, int] = field(default_factory=dict)


def merge(sources: Sequence[Path], target: Path) -> Merged:
    """Put the planned trials of all ``sources`` into ``target``, a new or an empty folder.

    What is stored in several is taken of the first that has it, unless a later one has a better
    status. Trials that belong to a machine, as times do, are told apart by it: those of another
    machine than the first have it in the label of their method, so that no table puts them beside
    one another as if they were of one.

    Raises:
        InputError: a folder holds no results or others', or the suites differ.
    """
    claim(target)
    if file_of(target) is not None:
        raise InputError(f"{target}: holds results already; expected an empty or a new folder")
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        merged = _merge(sources, fresh)
        shutil.copyfile(sources[0] / "suite.yaml", fresh / "suite.yaml")
        with locked(target):
            (target / FILE).unlink()  # which locking made, as a mark
            for name in (FILE, files.FOLDER, "suite.yaml"):
                if (fresh / name).exists():
                    os.replace(fresh / name, target / name)
        (target / LOCK).unlink()
        return merged
    finally:
        shutil.rmtree(fresh)


def _merge(sources: Sequence[Path], fresh: Path) -> Merged:
    merged, head, rows = Merged(), dict[str, Any](), dict[tuple, dict[str, Any]]()
    first: Any = None
    best: dict[str, Stored] = {}
    with locked(fresh), ResultsFolder(fresh, write=True) as new:
        for source in sources:
            with ResultsFolder(source) as old:
                plan, trials = old.plan(), old.trials()
                head = _agreed(head, plan, sources[0], source)
                merged.taken[source] = 0
                for row in plan["trials"]:
                    machine = row["identity"].get("machine")
                    first = first or machine
                    label = dict(row)
                    if machine not in (None, first):
                        label["method"] = f"{row['method']} [{_words(machine)}]"
                    rows.setdefault((row["trial"], label["method"]), label)
                    trial = trials.get(row["trial"])
                    if trial is None or trial.status == DAMAGED:
                        continue
                    known = best.get(trial.hash)
                    if known is not None and _rank(known) <= _rank(trial):
                        # As texts: nan is not equal to nan.
                        same = machine is not None or str(known.records) == str(trial.records)
                        if not same and known.folder != source:
                            merged.conflicts.setdefault(source, []).append(trial.hash)
                        continue
                    labels = {name: label[name] for name in LABELS}
                    best[trial.hash] = replace(trial, labels=labels)
                    _copy(old, new, best[trial.hash])
                    merged.taken[source] += 1
                    if machine not in (None, first):
                        words = _words(machine)
                        merged.elsewhere[words] = merged.elsewhere.get(words, 0) + 1
                _copy_code(old, new, trials)
        labels_of = {k: list(dict.fromkeys(r[k] for r in rows.values() if r[k])) for k in _LISTED}
        new.write_plan(head | {f"{k}s": v for k, v in labels_of.items()}, rows.values())
    return merged


_LISTED = ("material", "method", "scene", "measure")


def _agreed(head: dict[str, Any], plan: dict[str, Any], first: Path, source: Path) -> dict:
    """The head of the merged plan; refused where the two are not of one suite."""
    other = {key: value for key, value in plan.items() if key != "trials"}
    if not head:
        return other
    for key in _SAME:
        if head.get(key) != other.get(key):
            raise InputError(
                f"{source}: {key} is '{other.get(key) or ''}', in {first} it is"
                f" '{head.get(key) or ''}'; expected results of one suite"
            )
    return head


def _copy(old: ResultsFolder, new: ResultsFolder, trial: Stored) -> None:
    for name, digest in trial.files.items():
        place = files.place(new.folder, name, digest)
        place.parent.mkdir(exist_ok=True)
        if not place.exists():
            shutil.copyfile(files.checked(old.folder, name, digest), place)
    new.save(trial, old.arrays(trial.hash), trial.files)


def _copy_code(old: ResultsFolder, new: ResultsFolder, trials: dict[str, Stored]) -> None:
    """What tells whether the numbers still hold."""
    digests = {digest for trial in trials.values() for digest in trial.parts.values()}
    code.note_units(new, {d: units for d in digests if (units := code.units(old, d))})
    for change in code.equivalents(old):
        code.note_equivalent(new, *change)
    known = code.probes(new)
    for (part, digest), about in code.probes(old).items():
        if (part, digest) not in known:
            code.save_probe(new, part, digest, *about, code.probe(old, part, digest))


def _rank(trial: Stored) -> int:
    return _RANK.index(trial.status) if trial.status in _RANK else len(_RANK)


def _words(machine: dict[str, Any]) -> str:
    parts = [str(machine.get("cpu") or "?"), f"{machine.get('cores')} cores"]
    return ", ".join([*parts, *([str(machine["gpu"])] if machine.get("gpu") else [])])
