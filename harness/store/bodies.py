"""A trial as the bytes that the database holds, and back."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from harness.store.forms import checked_body
from harness.store.packing import MOST_TEXT, digest, json_bytes, pack, parsed, unpack
from harness.store.stored import DAMAGED, LABELS, Stored

if TYPE_CHECKING:
    import numpy as np

_SHARED = ("trial", "environment", "documents", "entries")
"""Entries of a trial whose values are kept once for all trials that share them."""
_APART = ("hash", "folder", "reader", "files", "arrays", "kept_arrays", "images")


class Texts:
    """Plain data that many trials share: kept once, named by the digest of its JSON."""

    def __init__(self, connection: sqlite3.Connection):
        self._connection = connection
        self._known: dict[str, Any] = {}
        self._bad: dict[str, str] = {}
        self._read: dict[str, Any] = {}

    def read_all(self) -> None:
        """Read all at once, which is faster than one by one where most will be asked for."""
        self._read = dict(self._connection.execute("SELECT digest, body FROM text"))

    def put(self, data: Mapping[str, Any]) -> dict[str, str]:
        """The values of ``data`` as digests; call it inside a transaction."""
        found = {}
        for key, value in data.items():
            text = json_bytes(value)
            found[key] = digest(text)
            if found[key] not in self._known:
                # What stands there under this digest may be damaged.
                row = (found[key], pack(text, most=MOST_TEXT))
                self._connection.execute("INSERT OR REPLACE INTO text VALUES (?, ?)", row)
                self._known[found[key]] = value
                self._bad.pop(found[key], None)
        return found

    def get(self, data: Mapping[str, str]) -> dict[str, Any]:
        """What :meth:`put` was given.

        Raises:
            ValueError: a text is not what was put.
        """
        for kept in data.values():
            if kept in self._bad:
                raise ValueError(self._bad[kept])
            if kept not in self._known:
                try:
                    self._known[kept] = _text_of(self._body(kept), kept)
                except ValueError as error:
                    # It is asked for by many trials, and may take long to be found bad.
                    self._bad[kept] = str(error)
                    raise
        return {key: self._known[kept] for key, kept in data.items()}

    def _body(self, kept: str) -> Any:
        if kept in self._read:
            return self._read.pop(kept)
        row = self._connection.execute("SELECT body FROM text WHERE digest = ?", (kept,)).fetchone()
        return row[0] if row else None


def _text_of(body: Any, kept: str) -> Any:
    text = unpack(body, most=MOST_TEXT) if isinstance(body, bytes) else b""
    if digest(text) != kept:
        raise ValueError(f"the text {kept} does not match its checksum")
    return parsed(text)


def body_of(
    trial: Stored, texts: Texts, arrays: Mapping[str, str], kept: Mapping[str, str]
) -> bytes:
    """JSON of a trial, with the digests of its ``arrays`` and of its files ``kept``."""
    body = {
        key: value
        for key, value in vars(trial).items()
        if key not in _APART and value not in ("", {}, [])
    }
    for key in _SHARED:
        if key in body:
            body[key] = texts.put(body[key])
    whole = {**body, "trial_key": trial.hash, "arrays": dict(arrays), "files": dict(kept)}
    return json_bytes(whole)


def stored_of(
    reader: partial[dict[str, np.ndarray]],
    texts: Texts,
    key: str,
    checksum: str,
    body: bytes,
) -> Stored:
    """The trial of a body; of status ``damaged`` if that is not what was stored.

    ``body`` is unpacked, or empty if it could not be. ``reader``, a function of the folder, reads
    arrays when they are asked for.
    """
    try:
        if digest(body) != checksum:
            raise ValueError("it does not match its checksum")
        data = checked_body(parsed(body))
        if data.pop("trial_key") != key:
            raise ValueError("it is another trial's")
        data["kept_arrays"] = data.pop("arrays")
        for name in _SHARED:
            if name in data:
                data[name] = texts.get(data[name])
        data["records"] = [_numbered(record) for record in data.get("records", ())]
        return Stored(key, folder=reader.args[0], reader=reader, **{"reason": "", **data})
    except (ValueError, TypeError, KeyError) as error:
        reason = f"the stored trial {key} is damaged: {error}; harness run measures it again"
        return Stored(key, {}, dict.fromkeys(LABELS, ""), DAMAGED, reason)


def _numbered(record: dict[str, Any]) -> dict[str, Any]:
    """With its numbers as numbers: those that are not finite are stored as text."""
    for key in ("value", "ci_low", "ci_high"):
        if type(record[key]) is not float:
            record[key] = float(record[key])
    return record
