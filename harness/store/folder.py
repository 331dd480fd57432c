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
from functools import cached_property, partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from harness.core.protocol.errors import InputError
from harness.store import files
from harness.store.database import Damaged, connect, explained, transaction
from harness.store.packing import array_bytes, array_of, digest, json_bytes, pack, unpack
from harness.store.stored import DAMAGED, LABELS, NOT_RUN, Stored

if TYPE_CHECKING:
    import numpy as np

_SHARED = ("trial", "environment", "documents", "entries")
"""Entries of a trial whose values are kept once for all trials that share them."""


class ResultsFolder:
    """An open results folder; use it as a context manager. Every call is a transaction.

    Raises:
        InputError: from all calls, one line: not there, another format, locked by another run,
            read-only, the disk is full, damaged.
    """

    def __init__(self, folder: str | Path, write: bool = False):
        self.folder, self.write = Path(folder), write
        self._connection = connect(self.folder, write)

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
            digests = self.keep_arrays(trial.hash, arrays)
            body = json_bytes(self._body(trial, digests, kept))
            self.run(
                "INSERT OR REPLACE INTO trial VALUES (?, ?, ?)",
                *(trial.hash, digest(body), pack(body)),
            )
        return self.trial(trial.hash)

    def write_plan(self, head: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
        """Replace the plan: ``head``, and a row per planned trial.

        A row holds the key under ``trial``, its labels, its ``identity`` and the key of the
        ``fit`` that it needs.
        """
        with self.writing():
            self.run("DELETE FROM plan")
            self.run("INSERT OR REPLACE INTO meta VALUES ('plan', ?)", json_bytes(head).decode())
            for position, row in enumerate(rows):
                labels = [row[key] for key in LABELS]
                identity = json_bytes(self._shared(row["identity"])).decode()
                self.run(
                    "INSERT INTO plan VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    *(position, row["trial"], *labels, row["fit"], identity),
                )

    def keep_arrays(self, key: str, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Inside of :meth:`writing`: replace the arrays under ``key``; their digests.

        The same content is kept once.
        """
        self.run("DELETE FROM array WHERE trial = ?", key)
        digests = {}
        for name, array in arrays.items():
            data = array_bytes(array)
            digests[name] = digest(data)
            self.run("INSERT OR IGNORE INTO blob VALUES (?, ?)", digests[name], pack(data))
            self.run("INSERT INTO array VALUES (?, ?, ?)", key, name, digests[name])
        return digests

    def set_aside(self, trial: str, reason: str) -> None:
        """Take a damaged trial out of the results; what is left of it is kept apart."""
        noticed = datetime.now(UTC).isoformat(timespec="seconds")
        with self.writing():
            self.run(
                "INSERT INTO damaged SELECT trial, ?, ?, body FROM trial WHERE trial = ?",
                *(noticed, reason, trial),
            )
            self.run("DELETE FROM trial WHERE trial = ?", trial)
            self.run("DELETE FROM array WHERE trial = ?", trial)

    def save_records(self, key: str, trial: Stored) -> None:
        """Replace records, status and reason of a stored trial; its raw data stay as they are."""
        with explained(self.folder):
            rows = self.run("SELECT name, digest FROM array WHERE trial = ?", key).fetchall()
        with self.writing():
            body = json_bytes(self._body(trial, dict(rows), trial.files))
            self.run(
                "UPDATE trial SET checksum = ?, body = ? WHERE trial = ?",
                digest(body),
                pack(body),
                key,
            )

    def check(self) -> None:
        """Raise :class:`~harness.store.database.Damaged` if the file is no whole database."""
        with explained(self.folder):
            (said,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        if said != "ok":
            raise Damaged(f"{self.folder}: {said}")

    def tidy(self) -> None:
        """Remove arrays and files that no trial names any more."""
        with self.writing():
            self.run("DELETE FROM blob WHERE digest NOT IN (SELECT digest FROM array)")
        named = [d for t in self.trials().values() for d in t.files.values()]
        files.sweep(self.folder, named)

    def compact(self) -> None:
        """Give the space of what was removed back to the disk."""
        with explained(self.folder):
            self._connection.execute("VACUUM")

    # --- reading -------------------------------------------------------------------------------

    def plan(self) -> dict[str, Any]:
        """The plan of the last run: suite, title, profile, baseline, report, labels and trials."""
        with explained(self.folder):
            found = self.run("SELECT value FROM meta WHERE name = 'plan'").fetchone()
            if found is None:
                raise InputError(f"{self.folder}: holds no plan yet; run the suite first")
            rows = self.run("SELECT * FROM plan ORDER BY position").fetchall()
        keys = ("trial", *LABELS, "fit")
        trials = [
            {**dict(zip(keys, row[1:-1], strict=True)), "identity": self._opened(_json(row[-1]))}
            for row in rows
        ]
        return {**_json(found[0]), "trials": trials}

    def keys(self) -> set[str]:
        """Keys of all stored trials, planned or not."""
        with explained(self.folder):
            return {key for (key,) in self.run("SELECT trial FROM trial")}

    def trial(self, key: str) -> Stored:
        """One trial; a planned one that was not run is ``skipped``."""
        found = self.trials([key])
        if key in found:
            return found[key]
        with explained(self.folder):
            row = self.run("SELECT * FROM plan WHERE trial = ?", key).fetchone()
        if row is None:
            raise InputError(f"{self.folder}: no trial '{key}'")
        labels = dict(zip(LABELS, row[2:8], strict=True))
        return Stored(key, self._opened(_json(row[9])), labels, "skipped", NOT_RUN)

    def trials(self, keys: Iterable[str] | None = None) -> dict[str, Stored]:
        """Stored trials by key, those of ``keys`` or all; a damaged one is an ``error``."""
        with explained(self.folder):
            rows = self.run("SELECT trial, checksum, body FROM trial").fetchall()
        wanted = None if keys is None else set(keys)
        return {r[0]: self._stored(*r) for r in rows if wanted is None or r[0] in wanted}

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

    def damage(self) -> dict[str, str]:
        """What is wrong with stored trials, by key: bodies, arrays and files are all read."""
        found = {k: t.reason for k, t in self.trials().items() if t.status == DAMAGED}
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
        seen: dict[tuple[str, str], str] = {}
        for key, trial in self.trials().items():
            for name, kept in trial.files.items():
                if (name, kept) not in seen:
                    seen[name, kept] = _file_damage(self.folder, name, kept)
                if seen[name, kept]:
                    found[key] = seen[name, kept]
        return found

    # --- inside --------------------------------------------------------------------------------

    def _body(
        self, trial: Stored, arrays: Mapping[str, str], kept: Mapping[str, str]
    ) -> dict[str, Any]:
        body = {
            key: value
            for key, value in vars(trial).items()
            if key not in ("hash", "folder", "reader", *_CACHED) and value not in ("", {}, [])
        }
        for key in _SHARED:
            if key in body:
                body[key] = self._shared(body[key])
        return {**body, "trial_key": trial.hash, "arrays": dict(arrays), "files": dict(kept)}

    def _shared(self, data: Mapping[str, Any]) -> dict[str, str]:
        """The values of ``data`` as digests of text that is kept once."""
        found = {}
        for key, value in data.items():
            text = json_bytes(value)
            found[key] = digest(text)
            if found[key] not in self._texts:
                self.run("INSERT OR IGNORE INTO text VALUES (?, ?)", found[key], pack(text))
                self._texts[found[key]] = value
        return found

    def _opened(self, data: Mapping[str, str]) -> dict[str, Any]:
        """What :meth:`_shared` was given."""
        for kept in data.values():
            if kept not in self._texts:
                with explained(self.folder):
                    row = self.run("SELECT body FROM text WHERE digest = ?", kept).fetchone()
                text = unpack(row[0]) if row else b""
                if digest(text) != kept:
                    raise ValueError(f"the text {kept} does not match its checksum")
                self._texts[kept] = _json(text)
        return {key: self._texts[kept] for key, kept in data.items()}

    @cached_property
    def _texts(self) -> dict[str, Any]:
        return {}

    def _stored(self, key: str, checksum: str, packed: bytes) -> Stored:
        try:
            body = unpack(packed)
            if digest(body) != checksum:
                raise ValueError("it does not match its checksum")
            data = _json(body)
            if data.pop("trial_key") != key:
                raise ValueError("it is another trial's")
            data.pop("arrays")
            for name in _SHARED:
                if name in data:
                    data[name] = self._opened(data[name])
            data["records"] = [_record(record) for record in data.get("records", ())]
            read = partial(_arrays, self.folder)
            return Stored(key, folder=self.folder, reader=read, **{"reason": "", **data})
        except (ValueError, TypeError, KeyError) as error:
            reason = f"the stored trial is damaged: {error}; harness run measures it again"
            return Stored(key, {}, dict.fromkeys(LABELS, ""), DAMAGED, reason)

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


def _arrays(folder: Path, key: str) -> dict[str, np.ndarray]:
    with ResultsFolder(folder) as results:
        return results.arrays(key)


_CACHED = ("arrays", "images", "files")


def _json(text: bytes | str) -> Any:
    return json.loads(text)


def _record(record: dict[str, Any]) -> dict[str, Any]:
    return {k: float(v) if k in ("value", "ci_low", "ci_high") else v for k, v in record.items()}


def _file_damage(folder: Path, name: str, kept: str) -> str:
    try:
        files.checked(folder, name, kept)
    except files.DamagedFile as error:
        return str(error)
    return ""
