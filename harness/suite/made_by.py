"""Materials of a suite that a command makes first: left out as long as their file is not there.

{name: rods, type: puresample, file: trained/rods.safetensors, made_by: harness material train ...}
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError

KEY = "made_by"


def sorted_out(materials: Any, locate: Callable[[str], str]) -> tuple[Any, dict[str, str]]:
    """``materials`` without those whose file is to be made, and the command for each of these.

    What stays loses the key. ``locate`` makes a path that a suite names absolute.

    Raises:
        InputError: ``made_by`` is no text or stands without a name or file; nothing is left.
    """
    if not isinstance(materials, list):
        return materials, {}
    kept, commands = [], {}
    for index, entry in enumerate(materials):
        if not isinstance(entry, dict) or KEY not in entry:
            kept.append(entry)
            continue
        command, name, file = (entry[key] for key in _checked(entry, f"materials[{index}]"))
        if Path(locate(file)).exists():
            kept.append({key: value for key, value in entry.items() if key != KEY})
        else:
            commands[name] = command
    if commands and not kept:
        raise InputError(f"materials: none is there: {'; '.join(lines(commands))}")
    return kept, commands


def lines(commands: Mapping[str, str]) -> list[str]:
    """What is to be said of the materials that these make."""
    return [f"'{name}' is left out, not made yet: {made_by}" for name, made_by in commands.items()]


def _checked(entry: dict[str, Any], where: str) -> tuple[str, ...]:
    keys = (KEY, "name", "file")
    for key in keys:
        value = entry.get(key)
        if not isinstance(value, str) or not value:
            beside = "" if key == KEY else f" beside '{KEY}'"
            raise InputError(f"{where}: {key}: expected a text{beside}, got {value!r}")
    return keys
