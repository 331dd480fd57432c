"""A folder of measured materials in a suite: one material a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest

SUFFIX = ".bsdf"


def spread(materials: Any, locate: Callable[[str], str]) -> Any:
    """``materials`` with each ``{type: measured, folder}`` replaced by its files, sorted.

    They are named by their files, without ``_rgb``. ``locate`` makes a path that a suite names
    absolute. What is no such entry is left as it is, for the schema to judge.

    Raises:
        InputError: a key too many, no such folder, or none with a measured BSDF in it.
    """
    if not isinstance(materials, list):
        return materials
    found = []
    for index, entry in enumerate(materials):
        if isinstance(entry, dict) and "folder" in entry:
            found += _files(entry, locate, f"materials[{index}]")
        else:
            found.append(entry)
    return found


def _files(entry: dict[str, Any], locate: Callable[[str], str], where: str) -> list[dict[str, Any]]:
    known = ("folder", "type")
    for key in entry:
        if key not in known:
            raise InputError(f"{where}: unknown key '{key}' beside 'folder'{nearest(key, known)}")
    if entry.get("type") != "measured":
        raise InputError(f"{where}: 'folder' goes with 'type: measured'")
    if not isinstance(entry["folder"], str):
        raise InputError(f"{where}: folder: expected the name of a folder, not {entry['folder']!r}")
    folder = Path(locate(entry["folder"]))
    if not folder.is_dir():
        raise InputError(
            f"{where}: no such folder: {entry['folder']} (expected one of measured BSDFs,"
            f" *{SUFFIX}, beside the suite or in the current folder)"
        )
    files = sorted(folder.glob(f"*{SUFFIX}"))
    if not files:
        raise InputError(f"{where}: no file *{SUFFIX} in the folder {entry['folder']}")
    return [
        {"name": file.stem.removesuffix("_rgb"), "type": "measured", "file": str(file)}
        for file in files
    ]
