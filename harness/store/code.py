"""What a results folder knows of the code that measured: its functions, and what probes found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from harness.store.arrays import names_of
from harness.store.database import explained
from harness.store.folder import ResultsFolder
from harness.store.forms import is_texts
from harness.store.packing import json_bytes, pack, parsed, unpack

if TYPE_CHECKING:
    import numpy as np


def note_units(results: ResultsFolder, sources: Mapping[str, Mapping[str, str]]) -> None:
    """Remember what digests of source code are made of: hashes by function, by digest."""
    with explained(results.folder):
        fresh = sources.keys() - {key for (key,) in results.run("SELECT digest FROM units")}
    if fresh:
        with results.writing():
            for key in fresh:
                body = pack(json_bytes(sources[key]))
                results.run("INSERT OR REPLACE INTO units VALUES (?, ?)", key, body)


def units(results: ResultsFolder, digest: str) -> dict[str, str]:
    """Hashes by function of a digest of source code; empty if it is not known."""
    with explained(results.folder):
        row = results.run("SELECT body FROM units WHERE digest = ?", digest).fetchone()
    try:
        found = parsed(unpack(row[0])) if row else {}
    except (ValueError, TypeError):
        return {}  # damaged; they only explain
    return found if is_texts(found) else {}


def note_equivalent(results: ResultsFolder, part: str, old: str, new: str, shared: str) -> None:
    """Remember what a probe found two versions of a part's code to share, by digest."""
    with results.writing():
        results.run("INSERT OR REPLACE INTO equivalent VALUES (?, ?, ?, ?)", part, old, new, shared)


def equivalents(results: ResultsFolder) -> set[tuple[str, str, str, str]]:
    """``(part, old digest, new digest, what they share)``; see :func:`note_equivalent`."""
    with explained(results.folder):
        return set(results.run("SELECT part, old, new, shared FROM equivalent"))


def save_probe(
    results: ResultsFolder,
    part: str,
    digest: str,
    trial: str,
    state: str,
    arrays: Mapping[str, np.ndarray],
) -> None:
    """Keep the probe of a version of a part's code.

    It was made with ``trial`` (a key) and the fitted ``state`` (a digest).
    """
    with results.writing():
        kept = json_bytes(results.keep_arrays(arrays)).decode()
        row = (part, digest, trial, state, kept)
        results.run("INSERT OR REPLACE INTO probe VALUES (?, ?, ?, ?, ?)", *row)


def probes(results: ResultsFolder) -> dict[tuple[str, str], tuple[str, str]]:
    """``(trial, fitted state)`` of the probe of each ``(part, digest)``."""
    with explained(results.folder):
        rows = results.run("SELECT part, digest, trial, state FROM probe").fetchall()
    return {(part, digest): (trial, state) for part, digest, trial, state in rows}


def probe(results: ResultsFolder, part: str, digest: str) -> dict[str, np.ndarray]:
    """The arrays of a probe.

    Raises:
        InputError: one does not match its checksum.
    """
    with explained(results.folder):
        row = results.run(
            "SELECT arrays FROM probe WHERE part = ? AND digest = ?", part, digest
        ).fetchone()
    return results.arrays_named(f"probe {part} {digest}", names_of(row[0]) if row else {})
