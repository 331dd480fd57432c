"""JSON files that are never seen half written, and that hold numbers which are none."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError


def dumps(data: Any, indent: int | None = None) -> str:
    """Strict JSON: what it has no number for becomes ``"nan"``, ``"inf"``, ``"-inf"``."""
    return json.dumps(_strict(data), indent=indent, ensure_ascii=False, allow_nan=False)


def write_json(path: Path, data: Any) -> None:
    """Write ``data`` as strict JSON; see :func:`dumps`."""
    write_text(path, dumps(data, indent=1))


def write_text(path: Path, text: str) -> None:
    """Write a text beside its place and rename it."""
    temporary = path.with_name(f".{path.name}-{os.getpid()}")
    temporary.write_text(text + "\n", encoding="utf-8")
    os.replace(temporary, path)


def read_json(path: Path) -> Any:
    """What a JSON file holds; :class:`InputError` if it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({error}); delete it, and the next run makes it again"
        ) from None


def _strict(data: Any) -> Any:
    if isinstance(data, float) and not math.isfinite(data):
        return str(data)
    if isinstance(data, Mapping):
        return {str(key): _strict(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_strict(value) for value in data]
    return data
