"""What of stored trials is not what was stored: all that is there is read and compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from harness.store import files
from harness.store.folder import ResultsFolder
from harness.store.stored import DAMAGED, Stored


def damage(store: ResultsFolder, trials: Mapping[str, Stored] | None = None) -> dict[str, str]:
    """What is wrong, by trial: bodies, raw arrays and files are compared with their checksums.

    ``trials`` are those of the store, if they were read already.
    """
    trials = store.trials() if trials is None else trials
    found = {key: trial.reason for key, trial in trials.items() if trial.status == DAMAGED}
    for key, reason in store.array_damage(trials).items():
        found.setdefault(key, reason)
    seen: dict[tuple[str, str], str] = {}
    for key, trial in trials.items():
        for name, kept in trial.files.items():
            if (name, kept) not in seen:
                seen[name, kept] = _file_damage(store.folder, name, kept)
            if seen[name, kept]:
                found.setdefault(key, seen[name, kept])
    return found


def _file_damage(folder: Path, name: str, kept: str) -> str:
    try:
        files.checked(folder, name, kept)
    except files.DamagedFile as error:
        return str(error)
    except OSError as error:
        return f"{files.place(folder, name, kept)}: cannot be read: {error.strerror}"
    return ""
