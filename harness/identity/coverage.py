"""Which units run as a whole while something is computed: every statement and every branch.

Two results that agree tell nothing about code that did not run. What a probe says of a changed
unit therefore counts only if the probe ran all of it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from inspect import CO_OPTIMIZED
from types import CodeType, FrameType
from typing import Any

from harness.identity.executed import Places
from harness.identity.regions import Span, Watched, regions, watched
from harness.identity.tree import Tree


@dataclass
class Coverage:
    """``whole`` units that ran in every statement and branch; ``partly`` those that ran in some."""

    whole: set[str] = field(default_factory=set)
    partly: set[str] = field(default_factory=set)


@contextmanager
def covered(tree: Tree) -> Iterator[Coverage]:
    """Filled when the block ends. Slow where code runs that is not wholly covered."""
    tracer, result = _Tracer(tree), Coverage()
    before = sys.gettrace()
    threading.settrace(tracer.call)
    sys.settrace(tracer.call)
    try:
        yield result
    finally:
        sys.settrace(before)
        threading.settrace(None)  # type: ignore[arg-type]
        tracer.sort(result)


class _Tracer:
    def __init__(self, tree: Tree):
        self.places = Places(tree)
        self.spans: dict[str, list[Span]] = {}
        self.codes: dict[CodeType, Watched | None] = {}

    def call(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:
        code = frame.f_code
        if code not in self.codes:
            self.codes[code] = self._watch(code)
        entry = self.codes[code]
        if entry is None or not entry.left:
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        left, of_offset = entry.left, entry.of_offset

        def step(frame: FrameType, event: str, argument: Any) -> Any:
            if event == "opcode":
                left.discard(of_offset.get(frame.f_lasti))  # type: ignore[arg-type]
            return step

        return step

    def _watch(self, code: CodeType) -> Watched | None:
        module = self.places.module(code.co_filename)
        if module is None or not code.co_flags & CO_OPTIMIZED:
            return None
        if code.co_filename not in self.spans:
            self.spans[code.co_filename] = regions(module.path.read_text(encoding="utf-8"))
        return watched(code, self.spans[code.co_filename])

    def sort(self, result: Coverage) -> None:
        """Whole is a unit if all code objects in it ran wholly, those inside functions too."""
        for code, entry in self.codes.items():
            if entry is None:
                continue
            unit = self.places.unit(code)
            if unit is None:
                continue
            complete = not entry.left and all(
                (inner := self.codes.get(each)) is not None and not inner.left
                for each in _inside(code)
            )
            (result.whole if complete else result.partly).add(unit)
        result.whole -= result.partly


def _inside(code: CodeType) -> Iterator[CodeType]:
    """Code objects of functions, lambdas and comprehensions in ``code``; not of classes."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_flags & CO_OPTIMIZED:
                yield constant
            yield from _inside(constant)
