"""Which regions of which functions run while something is computed.

Two results that agree tell nothing about code that did not run. What a probe says of a change
therefore counts only if the probe ran the places that are changed.
"""

from __future__ import annotations

import ast
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import CO_OPTIMIZED
from types import CodeType, FrameType
from typing import Any

from harness.identity.executed import Places
from harness.identity.modules import Module
from harness.identity.regions import SIGNATURE, Region, regions_of, watched
from harness.identity.tree import Tree

Coverage = dict[str, "Ran"]
"""By unit (``module:unit``): what ran of it. Functions that were never entered are not there."""


@dataclass(frozen=True)
class Ran:
    """Marks of the regions of a function that ran and that were ``missed``.

    ``missed_names`` are the identifiers in the missed ones.
    """

    run: frozenset[str]
    missed: frozenset[str]
    missed_names: frozenset[str]


@contextmanager
def covered(tree: Tree) -> Iterator[Coverage]:
    """Filled when the block ends. Slow where code runs that is not wholly covered yet."""
    tracer, result = _Tracer(tree), Coverage()
    before = sys.gettrace()
    threading.settrace(tracer.call)
    sys.settrace(tracer.call)
    try:
        yield result
    finally:
        sys.settrace(before)
        threading.settrace(None)  # type: ignore[arg-type]
        result |= tracer.result()


class _Function:
    """Regions of a unit, and which are left to be run."""

    def __init__(self, regions: list[Region]):
        self.regions = regions
        self.left = {i for i, region in enumerate(regions) if region.span != SIGNATURE}

    def ran(self) -> Ran:
        missed = {self.regions[i] for i in self.left}
        names = frozenset().union(*(region.names for region in missed))
        for region in self.regions:
            # Parameters are tried where all that reads them is.
            if region.span == SIGNATURE and region.names & names:
                missed.add(region)
        return Ran(
            frozenset(region.mark for region in self.regions if region not in missed),
            frozenset(region.mark for region in missed),
            names,
        )


class _Tracer:
    def __init__(self, tree: Tree):
        self.places = Places(tree)
        self.nodes: dict[str, dict[str, Any]] = {}
        self.functions: dict[str, _Function] = {}
        self.codes: dict[CodeType, tuple[_Function, dict[int, int], set[int]] | None] = {}

    def call(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:
        code = frame.f_code
        if code not in self.codes:
            self.codes[code] = self._watch(code)
        entry = self.codes[code]
        if entry is None:
            return None
        function, region_at, own = entry
        if own.isdisjoint(function.left):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        left = function.left

        def step(frame: FrameType, event: str, argument: Any) -> Any:
            if event == "opcode":
                left.discard(region_at.get(frame.f_lasti, -1))
            return step

        return step

    def _watch(self, code: CodeType) -> tuple[_Function, dict[int, int], set[int]] | None:
        if not code.co_flags & CO_OPTIMIZED:
            return None
        module, unit = self.places.module(code.co_filename), self.places.unit(code)
        if module is None or unit is None:
            return None
        if unit not in self.functions:
            node = self._nodes(module).get(unit.rpartition(":")[2])
            if node is None:
                return None
            self.functions[unit] = _Function(regions_of(node, module.data["bindings"]))
        function = self.functions[unit]
        region_at = watched(code, function.regions)
        return function, region_at, set(region_at.values())

    def _nodes(self, module: Module) -> dict[str, Any]:
        """Functions of a file by the name of their unit; the last of several."""
        if module.name not in self.nodes:
            found: dict[str, Any] = {}
            _collect(ast.parse(module.path.read_text(encoding="utf-8")), "", found)
            self.nodes[module.name] = found
        return self.nodes[module.name]

    def result(self) -> Coverage:
        return {unit: function.ran() for unit, function in self.functions.items()}


def _collect(node: ast.AST, prefix: str, found: dict[str, Any]) -> None:
    for child in getattr(node, "body", ()):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            found[prefix + child.name] = child
        elif isinstance(child, ast.ClassDef):
            _collect(child, f"{prefix}{child.name}.", found)
