"""What of a results folder is valid, stale, missing, failed or of another machine."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from harness.analysis.results import Results
from harness.core import machine
from harness.store.database import OLD_PLAN, file_of, folders_in
from harness.store.frame import STALE
from harness.store.stored import Stored

FAILED = ("error", "timeout", "nonfinite")
_KINDS = ("valid", "stale", "missing", "failed", "unsupported", "skipped")


@dataclass
class Status:
    """Planned trials of one suite by what can be said of them.

    ``counts`` by ``valid``, ``stale``, ``missing``, ``failed``, ``unsupported``, ``skipped``;
    ``elsewhere`` are valid timings that were taken on another machine; ``reasons`` counts why
    trials are stale or failed, ``findings`` what methods changed that is not theirs; ``failed`` has
    the failed ones. ``earlier`` are fits that came with the harness and that an earlier version of
    the code made: they are valid, for a fitted state is data.
    """

    folder: Path
    suite: str
    counts: Counter[str] = field(default_factory=Counter)
    elsewhere: int = 0
    earlier: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    findings: Counter[str] = field(default_factory=Counter)
    failed: list[Stored] = field(default_factory=list)

    @property
    def all_valid(self) -> bool:
        """Whether every planned trial has numbers that hold, or can have none."""
        return not any(self.counts[kind] for kind in ("stale", "missing", "failed", "skipped"))

    def line(self) -> str:
        """``table2: 1188 trials: 1180 valid, 8 stale``."""
        parts = [f"{self.counts[kind]} {kind}" for kind in _KINDS if self.counts[kind]]
        if self.elsewhere:
            parts.append(f"{self.elsewhere} timed on another machine")
        total = self.counts.total()
        return f"{self.suite}: {total} trial{'s' * (total != 1)}: {', '.join(parts) or 'none'}"


def status(folder: Path) -> Status:
    """Of one results folder; nothing is computed anew.

    Raises:
        InputError: no results there, or of another format.
    """
    return counted(folder, Results.load(folder))


def counted(folder: Path, results: Results) -> Status:
    """As :func:`status`, of results that are loaded already."""
    found = Status(folder, str(results.plan.get("suite") or folder.name))
    here = machine.identity(str(results.plan.get("device") or "cpu"))
    rows = results.frame.drop_duplicates("trial").set_index("trial")
    for key, said, why in zip(rows.index, rows["status"], rows["reason"], strict=True):
        stored = results.found.get(key)
        kind = "missing" if stored is None else _kind(str(said))
        found.counts[kind] += 1
        if kind in ("stale", "failed"):
            found.reasons[str(why)] += 1
        found.findings.update(stored.findings if stored else ())
        if stored and kind == "failed":
            found.failed.append(stored)
        found.earlier += key in results.earlier
        if stored and kind == "valid" and stored.trial.get("machine", here) != here:
            found.elsewhere += 1
    return found


def folders(place: Path) -> list[Path]:
    """The results folders at or directly below ``place``."""
    if file_of(place) is not None or (place / OLD_PLAN).is_file():
        return [place]
    return folders_in(place)


def _kind(status: str) -> str:
    if status in FAILED:
        return "failed"
    return {"ok": "valid", STALE: "stale"}.get(status, status)
