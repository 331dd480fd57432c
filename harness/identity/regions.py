"""The places of a source file that have to be executed for a computation to have tried its code.

A region is a statement, a branch of a conditional expression, a later operand of ``and`` and
``or``, or what a lambda or comprehension gives. What only makes an error is none.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import CodeType

Span = tuple[int, int, int, int]
"""First line and column, last line and column."""


def regions(text: str) -> list[Span]:
    """All regions of a source text."""
    return list(_regions(ast.parse(text)))


def _regions(node: ast.AST) -> Iterator[Span]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Raise):
            continue
        if isinstance(child, ast.Assert):
            yield _span(child)
            yield from _regions(child.test)
            continue
        if isinstance(child, ast.stmt):
            yield _span(child)
        elif isinstance(child, ast.IfExp):
            yield _span(child.body)
            yield _span(child.orelse)
        elif isinstance(child, ast.BoolOp):
            yield from map(_span, child.values[1:])
        elif isinstance(child, ast.Lambda):
            yield _span(child.body)
        elif isinstance(child, ast.ListComp | ast.SetComp | ast.GeneratorExp):
            yield _span(child.elt)
        elif isinstance(child, ast.DictComp):
            yield _span(child.value)
        yield from _regions(child)


def _span(node: ast.AST) -> Span:
    return node.lineno, node.col_offset, node.end_lineno, node.end_col_offset  # type: ignore


@dataclass
class Watched:
    """One code object: the region of each instruction, and the regions that are left to be run."""

    of_offset: dict[int, int]
    left: set[int] = field(default_factory=set)


def watched(code: CodeType, spans: list[Span]) -> Watched:
    """The regions of ``spans`` that instructions of ``code`` belong to, the smallest of each."""
    ordered = sorted(range(len(spans)), key=lambda i: _size(spans[i]))
    inside = [i for i in ordered if _within(spans[i], code)]
    found: dict[int, int] = {}
    for index, (line, last, column, end) in enumerate(code.co_positions()):
        if line is None or column is None or last is None or end is None:
            continue
        for region in inside:
            first_line, first_column, last_line, last_column = spans[region]
            if (first_line, first_column) <= (line, column) and (last, end) <= (
                last_line,
                last_column,
            ):
                found[2 * index] = region
                break
    return Watched(found, set(found.values()))


def _within(span: Span, code: CodeType) -> bool:
    lines = [line for _, _, line in code.co_lines() if line is not None]
    return bool(lines) and span[0] <= max(lines) and span[2] >= min(lines)


def _size(span: Span) -> tuple[int, int]:
    return span[2] - span[0], span[3] - span[1] if span[2] == span[0] else 0
