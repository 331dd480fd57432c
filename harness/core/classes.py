"""Classes of a folder of Python files, read from their text without importing them."""

from __future__ import annotations

import ast
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from harness.core.protocol.errors import InputError


@dataclass(frozen=True)
class Declared:
    """A class as its source text declares it."""

    name: str
    """The literal of ``name = "..."`` in the class body, ``""`` if there is none."""
    class_name: str
    file: Path
    summary: str
    """First line of the docstring of the class, else of the file."""


def declared(file: Path) -> list[Declared]:
    """Top-level classes of ``file``; none if it is not valid Python (importing it will say so)."""
    try:
        return list(_declared(file, _stamp(file)))
    except (OSError, ValueError, SyntaxError):
        return []


@lru_cache(maxsize=512)
def _declared(file: Path, stamp: tuple[int, int]) -> tuple[Declared, ...]:
    """Remembered until the file changes, which ``stamp`` tells."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    title = _first_line(tree)
    return tuple(
        Declared(_literal(node), node.name, file, _first_line(node) or title)
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    )


def named(folder: Path) -> dict[str, Declared]:
    """All classes with a literal name in the ``*.py`` of ``folder``, by that name.

    Files whose name starts with ``_`` are helpers and are left out.
    """
    with os.scandir(folder) as entries:
        stamps = sorted(
            (entry.name, _stamp(entry))
            for entry in entries
            if entry.name.endswith(".py") and not entry.name.startswith("_")
        )
    return dict(_named(folder, tuple(stamps)))


def _stamp(file: Path | os.DirEntry[str]) -> tuple[int, int]:
    """Changes when the file does; zeros for a link to nothing."""
    try:
        stat = file.stat()
    except FileNotFoundError:
        return 0, 0
    return stat.st_mtime_ns, stat.st_size


@lru_cache(maxsize=16)
def _named(folder: Path, stamps: tuple[tuple[str, tuple[int, int]], ...]) -> dict[str, Declared]:
    """Remembered until a file of the folder comes, goes or changes: ``stamps`` tells."""
    found: dict[str, Declared] = {}
    for name, _ in stamps:
        found |= {item.name: item for item in declared(folder / name) if item.name}
    return found


def read_python(path: Path) -> str:
    """Text of a Python file; an :class:`InputError` if it cannot be read or parsed."""
    try:
        text = path.read_text(encoding="utf-8")
        ast.parse(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (SyntaxError, ValueError) as error:
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{path}{line}: not valid Python: {error}") from None
    return text


def _literal(node: ast.ClassDef) -> str:
    for item in node.body:
        if isinstance(item, ast.Assign):
            targets, value = item.targets, item.value
        elif isinstance(item, ast.AnnAssign):
            targets, value = [item.target], item.value
        else:
            continue
        named = any(isinstance(target, ast.Name) and target.id == "name" for target in targets)
        if named and isinstance(value, ast.Constant) and isinstance(value.value, str):
            return value.value
    return ""


def _first_line(node: ast.Module | ast.ClassDef) -> str:
    return (ast.get_docstring(node) or "").partition("\n")[0]
