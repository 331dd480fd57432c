"""The stored results of a suite: a database ``results.sqlite``, and files beside it.

    results.sqlite                  plan, trials, records, raw arrays (compressed)
    files/<digest>.exr|safetensors  images, states of fitted methods
    suite.yaml                      the suite as run
    report/

A trial appears whole or not at all. All that is read is compared with its checksum.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from harness.core.protocol.errors import InputError
from harness.store import arrays as raw
from harness.store import census, files
from harness.store.bodies import Texts, body_of, stored_of
from harness.store.database import Damaged, connect, explained, reading, transaction
from harness.store.forms import checked_plan
from harness.store.packing import MOST_TEXT, digest, json_bytes, pack, parsed, unpack
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
        with explained(self.folder):
            found = self.run("SELECT value FROM meta WHERE name = 'dictionary'").fetchone()
        self._dictionary = found[0] if found and isinstance(found[0], bytes) else b""

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
        body = body_of(trial, self._texts, self.keep_arrays(arrays), kept)
        checksum = digest(body)
        census.changed(self._connection, trial.hash, checksum)
        self.run(
            "INSERT OR REPLACE INTO trial VALUES (?, ?, ?)",
            *(trial.hash, checksum, pack(body, self._dictionary, MOST_TEXT)),
        )

    def save_records(self, trials: Mapping[str, Stored]) -> None:
        """Replace records, status and reason of stored trials; raw data stay as they are."""
        with self.writing():
            for key, trial in trials.items():
                body = body_of(trial, self._texts, trial.kept_arrays, trial.files)
                checksum = digest(body)
                census.changed(self._connection, key, checksum)
                self.run(
                    "UPDATE trial SET checksum = ?, body = ? WHERE trial = ?",
                    *(checksum, pack(body, self._dictionary, MOST_TEXT), key),
                )

    def write_plan(self, head: Mapping[str, Any], rows: Iterable[Mapping[str, Any]]) -> None:
        """Replace the plan: ``head``, and a row per planned trial.

        A row holds the key under ``trial``, its labels, its ``identity`` and the key of the
        ``fit`` that it needs.
        """
        with self.writing():
            planned = [{**row, "identity": self._texts.put(row["identity"])} for row in rows]
            plan = json_bytes({**head, "trials": planned})
            for name, value in (("plan", pack(plan)), ("plan checksum", digest(plan))):
                self.run("INSERT OR REPLACE INTO meta VALUES (?, ?)", name, value)

    def keep_arrays(self, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Inside of :meth:`writing`: keep arrays, the same content once; their digests by name."""
        return raw.keep(self._connection, arrays)

    def set_aside(self, trials: Mapping[str, str]) -> None:
        """Take trials out of the results, by key with the reason; their bodies are kept apart."""
        noticed = datetime.now(UTC).isoformat(timespec="seconds")
        with self.writing():
            for key, reason in trials.items():
                self.run(
                    "INSERT INTO damaged SELECT trial, ?, ?, body FROM trial WHERE trial = ?",
                    *(noticed, reason, key),
                )
                census.changed(self._connection, key, None)
                self.run("DELETE FROM trial WHERE trial = ?", key)
                # A probe has a key of its own (:mod:`harness.store.code`).
                self.run("DELETE FROM probe WHERE 'probe ' || part || ' ' || digest = ?", key)

    def tidy(self) -> None:
        """Remove arrays and files that no trial names any more."""
        trials = self.trials()
        with self.writing():
            raw.sweep(self._connection, self._named_arrays(trials))
        files.sweep(self.folder, [d for t in trials.values() for d in t.files.values()])

    # --- reading -------------------------------------------------------------------------------

    def plan(self) -> dict[str, Any]:
        """The plan of the last run: suite, title, profile, baseline, report, labels and trials."""
        with explained(self.folder):
            meta = dict(self.run("SELECT name, value FROM meta WHERE name LIKE 'plan%'"))
            if "plan" not in meta:
                raise InputError(f"{self.folder}: holds no plan yet; run the suite first")
            try:
                text = unpack(meta["plan"])
                if digest(text) != meta.get("plan checksum"):
                    raise ValueError("it does not match its checksum")
                plan = checked_plan(parsed(text))
                for row in plan["trials"]:
                    row["identity"] = self._texts.get(row["identity"])
                return plan
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
            reader = partial(_arrays_of, self.folder)
            if not one_by_one:
                self._texts.read_all()
            return {
                key: stored_of(reader, self._texts, key, checksum, self._unpacked(body))
                for key, checksum, body in rows
                if isinstance(key, str) and (wanted is None or key in wanted)
            }

    def arrays(self, key: str) -> dict[str, np.ndarray]:
        """The raw arrays of a trial.

        Raises:
            InputError: one does not match its checksum.
        """
        return self.arrays_named(key, self.trial(key).kept_arrays)

    def arrays_named(self, key: str, kept: Mapping[str, str]) -> dict[str, np.ndarray]:
        """Arrays by their digests; ``key`` is named where one is damaged.

        Raises:
            InputError: one does not match its checksum.
        """
        with explained(self.folder):
            return raw.read(self._connection, self.folder, key, kept)

    def array_damage(self, trials: Mapping[str, Stored]) -> dict[str, str]:
        """What is wrong with raw arrays, by trial, or by the key of a probe.

        ``trials`` are all that are stored.
        """
        with explained(self.folder):
            return raw.damage(self._connection, self.folder, self._named_arrays(trials))

    def check(self) -> None:
        """Raise :class:`~harness.store.database.Damaged` if the file is no whole database."""
        with explained(self.folder):
            (said,) = self.run("PRAGMA quick_check(1)").fetchone()
        if said != "ok":
            raise Damaged(f"{self.folder}: {said}")

    def lost(self) -> str:
        """Why trials that are not there may have been stored; "" if none was lost."""
        with explained(self.folder):
            if census.fits(self._connection):
                return ""
        return (
            f"{self.folder}: trials that were stored are not there any more; harness run measures"
            " them again"
        )

    def accept(self) -> None:
        """Take the trials that are there for all that were stored (see :meth:`lost`)."""
        with self.writing():
            census.begin_anew(self._connection)

    # --- inside --------------------------------------------------------------------------------

    def _unpacked(self, body: bytes) -> bytes:
        """A trial's body; empty, which no checksum is of, if it is damaged."""
        try:
            return unpack(body, self._dictionary, MOST_TEXT)
        except (ValueError, TypeError):
            return b""

    def _named_arrays(self, trials: Mapping[str, Stored]) -> dict[str, dict[str, str]]:
        """Digests of arrays by name, of ``trials`` and of all probes, by their keys."""
        probes = self.run("SELECT 'probe ' || part || ' ' || digest, arrays FROM probe").fetchall()
        found = {key: trial.kept_arrays for key, trial in trials.items()}
        return found | {key: raw.names_of(arrays) for key, arrays in probes}


def _arrays_of(folder: Path, key: str, kept: Mapping[str, str]) -> dict[str, np.ndarray]:
    with explained(folder), reading(folder) as connection:
        return raw.read(connection, folder, key, kept)
