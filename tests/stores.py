"""Small stores for tests: trials of a measure that gives its numbers itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from harness.core.record import Record
from harness.measures.base import Outcome
from harness.store import write
from harness.store.damage import damage as damage_of
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.stored import Stored

KEYS = ("0123456789abcdef", "fedcba9876543210", "00000000000000aa")


def labels(number: int) -> dict[str, object]:
    """Of the trial with this number, as a plan has them."""
    return {
        "suite": "s", "material": "m", "method": f"method-{number}", "scene": "",
        "measure": "own", "seed": 0,
    }  # fmt: skip


def save(store: ResultsFolder, key: str, number: int, noise: int = 0, image: bool = True) -> Stored:
    """Store the trial ``number``: records, array, document and image all hold the number.

    ``noise`` values in an array of its own take their place in the file.
    """
    arrays = {"numbers": np.full(64, float(number)), "all": np.arange(64)}
    if noise:
        arrays["noise"] = np.random.default_rng(number).random(noise)
    outcome = Outcome(
        records=[Record("number", float(number), unit="1")],
        arrays=arrays,
        images={"flat": np.full((4, 4, 3), float(number))} if image else {},
        documents={"about": f"trial {number}"},
    )
    about = Stored(key, {"number": number}, labels(number), "ok", "", started="monday")
    return write.save(store, about, outcome)


def make(folder: Path, keys: Sequence[str] = KEYS, noise: int = 0) -> Path:
    """A store of these trials, all planned, numbered in order; those with noise have no image."""
    with locked(folder), ResultsFolder(folder, write=True) as store:
        for number, key in enumerate(keys):
            save(store, key, number, noise, image=not noise)
        rows = [
            {"trial": key, **labels(number), "fit": "", "identity": {"number": number}}
            for number, key in enumerate(keys)
        ]
        store.write_plan({"suite": "s"}, rows)
    return folder


def consistent(store: ResultsFolder) -> int:
    """How many trials there are; each is whole, and all parts of it are of one save."""
    trials = store.trials()
    assert damage_of(store, trials) == {}
    for trial in trials.values():
        number = trial.records[0]["value"]
        assert trial.documents["about"] == f"trial {int(number)}"
        assert set(store.arrays(trial.hash)["numbers"]) == {number}
    return len(trials)
