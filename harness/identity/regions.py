"""The places of a function that have to run for a computation to have tried its code.

A region is a statement, a branch of a conditional expression, a later operand of ``and`` and
``or``, or what a lambda or comprehension gives. What only makes an error is none. A region is told
again in another version of the function by its ``mark``: a hash of its text, of the statement
before it, and of all that it lies in.
"""

from __future__ import annotations

import ast
import copy
import dis
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import CodeType

Span = tuple[int, int, int, int]
"""First line and column, last line and column."""
SIGNATURE = (0, 0, 0, 0)
"""Span of a function's parameters and decorators: there is no such place to run."""


@dataclass(frozen=True)
class Region:
    """One region; ``names`` are the identifiers in it, nested regions' among them."""

    span: Span
    mark: str
    names: frozenset[str]


def regions_of(
    node: ast.FunctionDef | ast.AsyncFunctionDef, bindings: Mapping[str, str]
) -> list[Region]:
    """Regions of a function, its signature first.

    ``bindings`` are the module's names: where an imported one comes from is part of a mark.
    """
    return list(_Finder(bindings).function(node))


class _Finder:
    def __init__(self, bindings: Mapping[str, str]):
        self.bindings = bindings

    def function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[Region]:
        head = "".join(map(ast.unparse, [*node.decorator_list, node.args]))
        arguments = {a.arg for a in ast.walk(node.args) if isinstance(a, ast.arg)}
        mark = _hash(head, *self._origins(node.args))
        yield Region(SIGNATURE, mark, frozenset(arguments))
        yield from self._block(node.body, "")

    def _block(self, body: list[ast.stmt], inside: str) -> Iterator[Region]:
        before = ""
        for node in body:
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
                continue
            head = _head(node)
            mark = _hash(inside, before, head, *self._origins(node))
            before = _hash(head)
            if isinstance(node, ast.Raise):
                continue
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield from self._block(node.body, mark)
                continue
            yield Region(_span(node), mark, _names(node))
            for name, value in ast.iter_fields(node):
                for item in value if isinstance(value, list) else [value]:
                    if isinstance(item, ast.ExceptHandler | ast.match_case):
                        yield from self._block(item.body, _hash(mark, name, _head(item)))
                    elif isinstance(item, ast.expr) and name != "msg":
                        yield from self._expression(item, mark)
                    elif isinstance(item, ast.withitem):
                        yield from self._expression(item.context_expr, mark)
                if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                    yield from self._block(value, _hash(mark, name))

    def _expression(self, node: ast.AST, inside: str) -> Iterator[Region]:
        parts: list[ast.expr] = []
        if isinstance(node, ast.IfExp):
            parts = [node.body, node.orelse]
        elif isinstance(node, ast.BoolOp):
            parts = node.values[1:]
        elif isinstance(node, ast.Lambda):
            parts = [node.body]
        elif isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp):
            parts = [node.elt]
        elif isinstance(node, ast.DictComp):
            parts = [node.value]
        for place, part in enumerate(parts):
            mark = _hash(inside, type(node).__name__, str(place), ast.unparse(part))
            yield Region(_span(part), mark, _names(part))
        for child in ast.iter_child_nodes(node):
            yield from self._expression(child, inside)

    def _origins(self, node: ast.AST) -> list[str]:
        """Where the imported names in it come from."""
        return [f"{n}={self.bindings[n]}" for n in sorted(_names(node)) if n in self.bindings]


def watched(code: CodeType, regions: list[Region]) -> dict[int, int]:
    """Offset of an instruction of ``code`` -> index of the smallest region that it is in."""
    ordered = sorted(
        (i for i, region in enumerate(regions) if region.span != SIGNATURE),
        key=lambda i: _size(regions[i].span),
    )
    found: dict[int, int] = {}
    begin = next((i.offset for i in dis.get_instructions(code) if i.opname == "RESUME"), -1)
    for index, (line, last, column, end) in enumerate(code.co_positions()):
        # Entering a function is no statement of it.
        if 2 * index <= begin or None in (line, last, column, end):
            continue
        for region in ordered:
            first_line, first_column, last_line, last_column = regions[region].span
            if (first_line, first_column) <= (line, column) and (last, end) <= (
                last_line,
                last_column,
            ):
                found[2 * index] = region
                break
    return found


def _head(node: ast.AST) -> str:
    """Text of a statement without the statements in it."""
    if not any(isinstance(v, list) and v and isinstance(v[0], ast.stmt) for v in _values(node)):
        bare = node
    else:
        bare = copy.copy(node)
        for name, value in ast.iter_fields(node):
            if isinstance(value, list) and value and isinstance(value[0], ast.stmt):
                setattr(bare, name, [ast.Pass()])
            elif isinstance(value, list) and value and isinstance(value[0], ast.excepthandler):
                setattr(bare, name, [])
    return ast.dump(bare) if isinstance(node, ast.match_case | ast.Try) else ast.unparse(bare)


def _values(node: ast.AST) -> list:
    return [value for _, value in ast.iter_fields(node)]


def _names(node: ast.AST) -> frozenset[str]:
    found = set()
    for each in ast.walk(node):
        if isinstance(each, ast.Name):
            found.add(each.id)
        elif isinstance(each, ast.Attribute):
            found.add(each.attr)
    return frozenset(found)


def _span(node: ast.AST) -> Span:
    return node.lineno, node.col_offset, node.end_lineno, node.end_col_offset  # type: ignore


def _size(span: Span) -> tuple[int, int]:
    return span[2] - span[0], span[3] - span[1] if span[2] == span[0] else 0


def _hash(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:8]
