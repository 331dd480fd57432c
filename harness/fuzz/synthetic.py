"""Made-up results: a store of as many trials as wanted, whose numbers are no measurements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from harness.core.record import Record
from harness.store import files
from harness.store.folder import ResultsFolder
from harness.store.lock import locked
from harness.store.stored import STATE, Stored
from harness.suite.trials import hash_of

METHODS = ("improved-baseline", "cosine", "histogram", "two-lobe")
MEASURE = "made-up"
"""No measure of the harness: its records are as they were stored."""
_SUITE = "made-up"


def make(folder: Path, materials: int = 3, seeds: int = 1, image: bytes = b"") -> Path:
    """A store of ``materials`` x methods x seeds, each a fit with a state and a measure.

    A trial has two numbers, two arrays, one of them shared, and a document. ``image`` is an EXR
    file that all of them have.
    """
    rows = []
    with locked(folder), ResultsFolder(folder, write=True) as store:
        kept = {"flat.exr": files.keep(folder, "flat.exr", image)} if image else {}
        with store.writing():
            for number, labels in enumerate(_labels(materials, seeds)):
                rows += _trial(store, labels, number, kept, folder)
        head = {
            "suite": _SUITE,
            "title": "Made-up results",
            "profile": "quick",
            "device": "cpu",
            "baseline": METHODS[0],
            "report": {"tables": None, "figures": []},
        }
        store.write_plan(head, rows)
    (folder / "suite.yaml").write_text(f"name: {_SUITE}\n", encoding="utf-8")
    return folder


def _labels(materials: int, seeds: int) -> list[dict[str, Any]]:
    return [
        {
            "suite": _SUITE,
            "material": f"material-{m}",
            "method": method,
            "scene": "",
            "measure": MEASURE,
            "seed": seed,
        }
        for m in range(materials)
        for seed in range(seeds)
        for method in METHODS
    ]


def _trial(
    store: ResultsFolder, labels: dict[str, Any], number: int, kept: dict[str, str], folder: Path
) -> list[dict[str, Any]]:
    """The fit and the measure of a method, and their rows of the plan."""
    rng = np.random.default_rng(number)
    identity = {
        "material": {"type": "named", "name": labels["material"]},
        "method": {"name": labels["method"], "params": {}, "budget": {"steps": 100}},
        "seed": labels["seed"],
    }
    state = files.keep(folder, STATE, rng.bytes(64))
    fit = hash_of({**identity, "measure": {"name": "made-up fit", "settings": {}}})
    found = []
    for key, name, arrays, own in (
        (fit, "made-up fit", {"loss": rng.random(20)}, {STATE: state}),
        ("", MEASURE, {"values": rng.random(64), "all": np.arange(64)}, kept),
    ):
        asked = {**identity, "measure": {"name": name, "settings": {"conditions": 64}}}
        key = key or hash_of(asked)
        here = {**labels, "measure": name}
        value = float(number + 1)
        records = [
            vars(Record("value", value, value - 0.25, value + 0.25, "1")),
            vars(Record("seconds", rng.random(), unit="s")),
        ]
        about = Stored(
            key, asked, here, "ok", "", records, {"machine": {"cpu": "none"}, "python": "3"},
            started="2024-01-01T00:00:00+00:00", seconds=1.0, fit="" if own is not kept else fit,
            documents={"about": f"trial {number} of {name}"},
            state=own.get(STATE, ""),
        )  # fmt: skip
        store.put(about, arrays, own)
        found.append({"trial": key, **here, "fit": about.fit, "identity": asked})
    return found
