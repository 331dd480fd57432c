"""Tables and figures, found by file: ``tables/NAME.py`` and ``figures/NAME.py``.

A file holds a table or figure if it defines a function of the file's own name: ``equal_spp.py``
with ``def equal_spp`` is called ``equal-spp`` in suites. Its module-level ``ORDER``, a number, is
its place in a report; without one it comes last. Names are read from source text, so that listing
them imports neither matplotlib nor pandas.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

KINDS = ("tables", "figures")


@dataclass(frozen=True)
class Part:
    """A table or figure as its file declares it."""

    name: str
    kind: str
    """``"tables"`` or ``"figures"``."""
    module: str
    order: float
    summary: str
    """First line of the function's docstring."""

    def load(self) -> Callable[..., Any]:
        """The function. A table's takes results and gives a Table, or a sentence why not; a
        figure's takes results and a Canvas and gives a list of Drawn, or why not."""
        return getattr(import_module(self.module), self.name.replace("-", "_"))


def parts(kind: str) -> dict[str, Part]:
    """All parts of a kind by name, in the order of a report."""
    package = f"harness.report.{kind}"
    found = [
        part
        for folder in import_module(package).__path__
        for file in sorted(Path(folder).glob("*.py"))
        if (part := _part(kind, package, file, file.stat().st_mtime_ns))
    ]
    found.sort(key=lambda part: (part.order, part.name))
    return {part.name: part for part in found}


def part(kind: str, name: str) -> Callable[..., Any]:
    """The function of the table or figure called ``name``; ``KeyError`` if there is none."""
    return parts(kind)[name].load()


def names(kind: str) -> list[str]:
    """Names that a suite may use under ``report: {KIND: [...]}``."""
    return list(parts(kind))


@lru_cache(maxsize=256)
def _part(kind: str, package: str, file: Path, stamp: int) -> Part | None:
    """What ``file`` declares; None for a helper. Remembered until the file changes (``stamp``)."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == file.stem:
            summary = (ast.get_docstring(node) or "").partition("\n")[0]
            name = file.stem.replace("_", "-")
            return Part(name, kind, f"{package}.{file.stem}", _order(tree), summary)
    return None


def _order(tree: ast.Module) -> float:
    """The literal of a module-level ``ORDER = number``."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            named = any(isinstance(t, ast.Name) and t.id == "ORDER" for t in node.targets)
            if named and isinstance(node.value.value, (int, float)):
                return float(node.value.value)
    return math.inf
