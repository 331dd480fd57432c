"""The stored results of a suite: a database ``results.sqlite``, and files beside it.

    results.sqlite                  plan, trials, records, raw arrays (compressed)
    files/<digest>.exr|safetensors  images, states of fitted methods
    suite.yaml                      the suite as run
    report/

A trial appears whole or not at all. All that is read is compared with its checksum.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from harness.core.protocol.errors import InputError
from harness.store import files
from harness.store.bodies import Texts, body_of, stored_of
from harness.store.database import Damaged, connect, explained, transaction
from harness.store.packing import array_bytes, array_of, digest, json_bytes, pack, parsed, unpack
from harness.store.stored import LABELS, NOT_RUN, Stored

if TYPE_CHECKING:
    import numpy as np

_FEW = 500
"""Trials that are asked for by their keys; more of them are picked from all."""


class ResultsFolder:
    """An open results folder; use it as a context manager. Every call is a transaction.

    Raises:
        InputError: from all calls, one line: not there, another format, locked by another run,
            read-only, the disk is full, damaged.
    """

    def __init__(self, folder: str | Path, write: bool = False):
        self.folder, self.write = Path(folder), write
        self._connection = connect(self.folder, write)
        self._texts = Texts(self._connection)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the file."""
        self._connection.close()

    def run(self, statement: str, *values: Any) -> sqlite3.Cursor:
        """One statement; SQLite's errors are those of the caller's :func:`explained`."""
        return self._connection.execute(statement, values)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """A transaction: all of what is inside, or nothing of it."""
        with explained(self.folder), transaction(self._connection):
            yield

    @contextmanager
    def as_it_is(self) -> Iterator[None]:
        """All that is read inside is of one moment, whoever writes meanwhile."""
        with explained(self.folder):
            self.run("BEGIN")
            try:
                yield
            finally:
                if self._connection.in_transaction:
                    self.run("COMMIT")

    # --- writing -------------------------------------------------------------------------------

    def save(
        self, trial: Stored, arrays: Mapping[str, np.ndarray], kept: Mapping[str, str]
    ) -> Stored:
        """Store a trial; an older one of the same key is replaced.

        ``kept`` are its files by name, as :func:`harness.store.files.keep` gave their digests.

        Raises:
            ValueError, TypeError: something in it cannot be stored.
        """
        with self.writing():
            self.put(trial, arrays, kept)
        return self.trial(trial.hash)

    def put(self, trial: Stored, arrays: Mapping[str, np.ndarray], kept: Mapping[str, str]) -> None:
        """Inside of :meth:`writing`: what :meth:`save` does, for one of many trials."""
        digests = self.keep_arrays(trial.hash, arrays)
        body = body_of(trial, self._texts, digests, kept)
        self.run(
            "INSERT OR REPLACE INTO trial VALUES (?, ?, ?)",
            *(trial.hash, digest(body), pack(body)),
        )

    def save_records(self, trials: Mapping[str, Stored]) -> None:
        """Replace records, status and reason of stored trials; raw data stay as they are."""
        with self.writing():
            arrays = self._arrays()
            for key, trial in trials.items():
                body = body_of(trial, self._texts, arrays.get(key, {}), trial.files)
                self.run(
                    "UPDATE trial SET checksum = ?, body = ? WHERE trial = ?",
                    *(digest(body), pack(body), key),
                )

    def write_plan(self, head: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
        """Replace the plan: ``head``, and a row per planned trial.

        A row holds the key under ``trial``, its labels, its ``identity`` and the key of the
        ``fit`` that it needs.
        """
        with self.writing():
            packed = [
                (
                    *(position, row["trial"], *(row[key] for key in LABELS), row["fit"]),
                    json_bytes(self._texts.put(row["identity"])).decode(),
                )
                for position, row in enumerate(rows)
            ]
            text = json_bytes(head).decode()
            self.run("DELETE FROM plan")
            self._connection.executemany(
                "INSERT INTO plan VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", packed
            )
            for name, value in (("plan", text), ("plan checksum", _plan_digest(text, packed))):
                self.run("INSERT OR REPLACE INTO meta VALUES (?, ?)", name, value)

    def keep_arrays(self, key: str, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Inside of :meth:`writing`: replace the arrays under ``key``; their digests.

        The same content is kept once.
        """
        self.run("DELETE FROM array WHERE trial = ?", key)
        digests = {}
        for name, array in arrays.items():
            data = array_bytes(array)
            digests[name] = digest(data)
            # What stands there under this digest may be damaged.
            self.run("INSERT OR REPLACE INTO blob VALUES (?, ?)", digests[name], pack(data))
            self.run("INSERT INTO array VALUES (?, ?, ?)", key, name, digests[name])
        return digests

    def set_aside(self, trials: Mapping[str, str]) -> None:
        """Take trials out of the results, by key with the reason; their bodies are kept apart."""
        noticed = datetime.now(UTC).isoformat(timespec="seconds")
        with self.writing():
            for key, reason in trials.items():
                self.run(
                    "INSERT INTO damaged SELECT trial, ?, ?, body FROM trial WHERE trial = ?",
                    *(noticed, reason, key),
                )
                self.run("DELETE FROM trial WHERE trial = ?", key)
                self.run("DELETE FROM array WHERE trial = ?", key)
                # Arrays of a probe stand under a key of their own (:mod:`harness.store.code`).
                self.run("DELETE FROM probe WHERE 'probe ' || part || ' ' || digest = ?", key)

    def tidy(self) -> None:
        """Remove arrays and files that no trial names any more."""
        with self.writing():
            self.run("DELETE FROM blob WHERE digest NOT IN (SELECT digest FROM array)")
        named = [d for t in self.trials().values() for d in t.files.values()]
        files.sweep(self.folder, named)

    def compact(self) -> None:
        """Give the space of what was removed back to the disk."""
        with explained(self.folder):
            self.run("VACUUM")

    # --- reading -------------------------------------------------------------------------------

    def plan(self) -> dict[str, Any]:
        """The plan of the last run: suite, title, profile, baseline, report, labels and trials."""
        with explained(self.folder):
            meta = dict(self.run("SELECT name, value FROM meta").fetchall())
            rows = self.run("SELECT * FROM plan ORDER BY position").fetchall()
            if "plan" not in meta:
                raise InputError(f"{self.folder}: holds no plan yet; run the suite first")
            keys = ("trial", *LABELS, "fit")
            try:
                if _plan_digest(meta["plan"], rows) != meta.get("plan checksum"):
                    raise ValueError("it does not match its checksum")
                trials = [
                    {
                        **dict(zip(keys, row[1:-1], strict=True)),
                        "identity": self._texts.get(parsed(row[-1])),
                    }
                    for row in rows
                ]
                return {**parsed(meta["plan"]), "trials": trials}
            except (ValueError, TypeError) as error:
                raise Damaged(
                    f"{self.folder}: the stored plan is damaged: {error}; harness run writes it"
                    " again"
                ) from None

    def keys(self) -> set[str]:
        """Keys of all stored trials, planned or not."""
        with explained(self.folder):
            return {key for (key,) in self.run("SELECT trial FROM trial")}

    def trial(self, key: str) -> Stored:
        """One trial; a planned one that was not run is ``skipped``."""
        found = self.trials([key])
        if key in found:
            return found[key]
        for row in self.plan()["trials"]:
            if row["trial"] == key:
                labels = {name: row[name] for name in LABELS}
                return Stored(key, row["identity"], labels, "skipped", NOT_RUN)
        raise InputError(f"{self.folder}: no trial '{key}'")

    def trials(self, keys: Iterable[str] | None = None) -> dict[str, Stored]:
        """Stored trials by key, those of ``keys`` or all; one whose body is damaged says so."""
        wanted = None if keys is None else set(keys)
        one_by_one = wanted is not None and len(wanted) <= _FEW
        place = f" WHERE trial IN ({', '.join('?' * len(wanted or ()))})" if one_by_one else ""
        asked = sorted(wanted or ()) if one_by_one else ()
        with explained(self.folder):
            rows = self.run(f"SELECT trial, checksum, body FROM trial{place}", *asked).fetchall()
            arrays = self._arrays(place, *asked)
            reader = partial(_arrays_of, self.folder)
            return {
                row[0]: stored_of(reader, self._texts, *row, arrays.get(row[0], {}))
                for row in rows
                if wanted is None or row[0] in wanted
            }

    def arrays(self, key: str) -> dict[str, np.ndarray]:
        """The raw arrays of a trial.

        Raises:
            InputError: one does not match its checksum.
        """
        with explained(self.folder):
            rows = self.run(
                "SELECT name, array.digest, body FROM array LEFT JOIN blob USING (digest)"
                " WHERE trial = ?",
                key,
            ).fetchall()
        return {name: array_of(self._intact(key, name, kept, body)) for name, kept, body in rows}

    def array_damage(self) -> dict[str, str]:
        """What is wrong with raw arrays, by trial."""
        found: dict[str, str] = {}
        with explained(self.folder):
            rows = self.run(
                "SELECT array.digest, body, group_concat(trial), min(name) FROM array"
                " LEFT JOIN blob USING (digest) GROUP BY array.digest"
            )
            for kept, body, trials, name in rows:
                try:
                    self._intact(trials, name, kept, body)
                except InputError as error:
                    found.update(dict.fromkeys(trials.split(","), str(error)))
        return found

    def check(self) -> None:
        """Raise :class:`~harness.store.database.Damaged` if the file is no whole database."""
        with explained(self.folder):
            (said,) = self.run("PRAGMA quick_check(1)").fetchone()
        if said != "ok":
            raise Damaged(f"{self.folder}: {said}")

    # --- inside --------------------------------------------------------------------------------

    def _arrays(self, place: str = "", *asked: str) -> dict[str, dict[str, str]]:
        """Digests of arrays by trial and name."""
        found: dict[str, dict[str, str]] = {}
        for trial, name, kept in self.run(f"SELECT trial, name, digest FROM array{place}", *asked):
            found.setdefault(trial, {})[name] = kept
        return found

    def _intact(self, trial: str, name: str, kept: str, body: bytes | None) -> bytes:
        try:
            data = unpack(body) if body is not None else b""
        except ValueError:
            data = b""
        if digest(data) != kept:
            raise InputError(
                f"{self.folder}: the stored array '{name}' of trial {trial} is damaged;"
                " harness run measures it again"
            )
        return data


def _arrays_of(folder: Path, key: str) -> dict[str, np.ndarray]:
    with ResultsFolder(folder) as results:
        return results.arrays(key)


def _plan_digest(head: str, rows: list[tuple]) -> str:
    # Text and whole numbers alone; of many rows the encoder of the standard library is the faster.
    return digest(json.dumps([head, *rows], separators=(",", ":")).encode())
