"""Classes of a folder of Python files, read from their text without importing them."""

from __future__ import annotations

import ast
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
        stamp = file.stat()
        return list(_declared(file, (stamp.st_mtime_ns, stamp.st_size)))
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
    found: dict[str, Declared] = {}
    for file in sorted(folder.glob("*.py")):
        if not file.name.startswith("_"):
            found |= {item.name: item for item in declared(file) if item.name}
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
