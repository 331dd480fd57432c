"""Bounds on what a file may say, before anything is made of it: plain data of a sane size.

A few lines of YAML can stand for gigabytes: an alias of a list of aliases is ten times as large a
level. What is compared here is what the file stands for, not what it is written in.
"""

from __future__ import annotations

import math
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.text import printable, unprintable

DEPTH = 32
"""Lists and mappings within each other; the deepest suite of the project has eight."""
VALUES = 200_000
"""All that a file stands for, aliases written out: a hundred times the largest suite's."""
LENGTH = 20_000
"""Characters of one text."""
WHOLE = 2**63
"""What a whole number lies below: seeds and sizes are numbers of 64 bits."""


def check_plain(data: Any, where: str) -> None:
    """Refuse what is no plain data, or too much of it.

    Plain are texts of characters that can be printed, whole numbers of 64 bits, numbers that are
    numbers, true, false and null, and lists and mappings of them, with texts as keys.

    Raises:
        InputError: with ``where`` in front and the path of the key.
    """
    seen = 0
    todo: list[tuple[Any, str, int]] = [(data, "", 0)]
    while todo:
        value, path, depth = todo.pop()
        seen += 1
        if isinstance(value, dict | list | tuple) and seen + len(todo) + len(value) > VALUES:
            raise InputError(
                f"{where}: stands for more than {VALUES:,} values, aliases written out"
            )
        if depth > DEPTH:
            raise InputError(f"{where}: {_short(path)}: lists and mappings more than {DEPTH} deep")
        if isinstance(value, dict):
            for key, inner in value.items():
                if not isinstance(key, str):
                    said = f"expected a text as key, got {printable(repr(key), '')[:60]}"
                    hint = "put it between quotes, as any text with commas within { }"
                    raise InputError(f"{where}: {_prefix(path)}{said}; {hint}")
                _check_text(key, where, f"{_prefix(path)}a key")
                todo.append((inner, f"{path}.{key}" if path else key, depth + 1))
        elif isinstance(value, list | tuple):
            todo.extend((inner, f"{path}[{i}]", depth + 1) for i, inner in enumerate(value))
        else:
            _check_value(value, where, path)


def _check_value(value: Any, where: str, path: str) -> None:
    if isinstance(value, str):
        _check_text(value, where, _short(path) or "the text")
    elif isinstance(value, bool) or value is None:
        return
    elif isinstance(value, int):
        if not -WHOLE <= value < WHOLE:
            raise InputError(f"{where}: {_prefix(path)}expected a whole number of 64 bits")
    elif isinstance(value, float):
        if math.isnan(value):
            raise InputError(f"{where}: {_prefix(path)}expected a number, got nan")
    else:
        kind = type(value).__name__
        raise InputError(
            f"{where}: {_prefix(path)}expected a text, a number, true, false, a list or a mapping,"
            f" got a {kind}; put a text between quotes"
        )


def _check_text(text: str, where: str, what: str) -> None:
    if len(text) > LENGTH:
        raise InputError(f"{where}: {what}: a text of {len(text):,} characters; at most {LENGTH:,}")
    if text.isprintable():
        return
    for character in text:
        if unprintable(character) and character not in "\n\t":
            shown = printable(character)
            raise InputError(
                f"{where}: {what}: holds the character {shown}, which is not printable"
            )


def _prefix(path: str) -> str:
    return f"{_short(path)}: " if path else ""


def _short(path: str) -> str:
    shown = printable(path, "")
    return shown if len(shown) <= 200 else f"{shown[:100]}...{shown[-97:]}"
