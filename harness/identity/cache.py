"""Parsed source files, kept between runs in the user's cache folder.

Keyed by the content of a file, so that no time stamp has to be believed. The folder may be missing,
read-only or full: then everything is parsed again, and nothing is said.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from harness.identity import nodes, normal_form, piece, scopes, units

_MOST = 4000
"""Files that are remembered; a cache with more is begun anew."""


class Cache:
    """Units of files by the hash of their text. ``folder`` None keeps them in memory only."""

    def __init__(self, folder: Path | None = None):
        self._file = folder / f"units-{_version()}.json" if folder else None
        self._known: dict[str, dict[str, Any]] = self._read()
        self._fresh = 0

    def units(self, content: bytes) -> dict[str, Any]:
        """See :func:`harness.identity.units.units_of`."""
        key = hashlib.sha256(content).hexdigest()[:32]
        if key not in self._known:
            self._known[key] = units.units_of(content.decode("utf-8"))
            self._fresh += 1
        return self._known[key]

    def save(self) -> None:
        """Write what is new; nothing happens if that cannot be done."""
        if self._file is None or not self._fresh:
            return
        kept = self._known if len(self._known) <= _MOST else {}
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            # Written beside its place and renamed: another run may be reading.
            handle, name = tempfile.mkstemp(dir=self._file.parent, prefix=".units-")
            try:
                with os.fdopen(handle, "w", encoding="utf-8") as file:
                    json.dump(kept, file, separators=(",", ":"))
                os.replace(name, self._file)
                self._fresh = 0
            except OSError:
                os.unlink(name)
                raise

    def _read(self) -> dict[str, dict[str, Any]]:
        if self._file is None:
            return {}
        try:
            known = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return known if isinstance(known, dict) else {}


def _version() -> str:
    """Of the normal form and of Python's syntax tree."""
    text = f"{sys.version_info[:2]}"
    for module in (nodes, normal_form, piece, scopes, units):
        with contextlib.suppress(OSError):
            text += Path(module.__file__ or "").read_text(encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()[:12]
