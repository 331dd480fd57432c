"""Which units of ours run while something is computed."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from harness.identity.modules import Module
from harness.identity.tree import Tree


class Places:
    """Finds the unit that a code object belongs to."""

    def __init__(self, tree: Tree):
        self.tree = tree
        self._modules: dict[str, Module | None] = {}

    def module(self, filename: str) -> Module | None:
        """The module of a file of ours, None for any other file."""
        if filename not in self._modules:
            self._modules[filename] = self._find(filename)
        return self._modules[filename]

    def unit(self, code: CodeType) -> str | None:
        """``module:unit``; None for code that is not ours, or is a module's or class's own."""
        module = self.module(code.co_filename)
        if module is None or not code.co_flags & CO_OPTIMIZED:
            return None
        name = code.co_qualname.partition(".<locals>")[0]
        units = module.data["units"]
        if name not in units:
            # A lambda or comprehension outside functions: told by its line.
            name = innermost(units, code.co_firstlineno)
        return f"{module.name}:{name}" if name else None

    def _find(self, filename: str) -> Module | None:
        path = Path(filename)
        for top, root in self.tree.roots.items():
            if path.is_relative_to(root):
                parts = [top, *path.relative_to(root).with_suffix("").parts]
                return self.tree.module(".".join(p for p in parts if p != "__init__"))
        return None


def innermost(units: dict[str, Any], line: int) -> str:
    """Name of the smallest unit that has ``line``, ``""`` for none."""
    found = [
        (last - first, name)
        for name, unit in units.items()
        for first, last in unit["lines"]
        if first <= line <= last
    ]
    return min(found)[1] if found else ""


@contextmanager
def recorded(tree: Tree) -> Iterator[set[str]]:
    """The units (``module:unit``) whose code begins to run inside, in any thread.

    What runs when a module is imported is left out.
    """
    places, codes, units = Places(tree), set[CodeType](), set[str]()

    def note(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            codes.add(frame.f_code)

    before = sys.getprofile()
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield units
    finally:
        sys.setprofile(before)
        threading.setprofile(None)
        found = {places.unit(code) for code in codes}
        units.update(unit for unit in found if unit is not None)
