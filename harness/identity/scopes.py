"""Which names a function, comprehension or class body binds, so that locals can be told apart."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, field

Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_NAMED = (ast.ExceptHandler, ast.MatchAs, ast.MatchStar)
_LEAVES = frozenset({ast.Constant, ast.Lambda, ast.Load, ast.Store, ast.arguments, ast.Pass})
"""Nodes that bind nothing out here; a lambda has a scope of its own."""


@dataclass
class Scope:
    """Names bound in one scope. ``imports`` are the local ones, as references (``module:name``)."""

    kind: str
    names: set[str] = field(default_factory=set)
    kept: set[str] = field(default_factory=set)
    """Names that are shown as they are: parameters that a caller may give by keyword."""
    imports: dict[str, str] = field(default_factory=dict)


def of_function(node: Function, rename: bool, spoken: frozenset[str]) -> Scope:
    """Scope of a function. With ``rename`` its parameters are locals like others.

    ``spoken``: names that the file uses as keywords or texts; a parameter among them is kept.
    """
    scope = Scope("function")
    arguments = [a.arg for a in parameters(node.args)]
    scope.names.update(arguments)
    scope.kept.update(a for a in arguments if not rename or a in spoken)
    body = [node.body] if isinstance(node, ast.Lambda) else node.body
    _bind(body, scope)
    return scope


def of_class(node: ast.ClassDef) -> Scope:
    """Scope of a class body; its names are attributes and are never renamed."""
    scope = Scope("class")
    _bind(node.body, scope)
    return scope


def of_comprehension(generators: Iterable[ast.comprehension]) -> Scope:
    """Scope of a comprehension: the targets of its loops."""
    scope = Scope("function")
    for generator in generators:
        scope.names.update(n.id for n in ast.walk(generator.target) if isinstance(n, ast.Name))
    return scope


def parameters(args: ast.arguments) -> list[ast.arg]:
    """All parameters in order."""
    found = [*args.posonlyargs, *args.args]
    found += [args.vararg] if args.vararg else []
    found += args.kwonlyargs
    return found + ([args.kwarg] if args.kwarg else [])


def imported(node: ast.Import | ast.ImportFrom) -> dict[str, str]:
    """``{name bound: reference}`` of an import statement; ``import a.b`` binds ``a``."""
    if isinstance(node, ast.Import):
        return {
            a.asname or a.name.partition(".")[0]: f"{a.name if a.asname else a.name.split('.')[0]}:"
            for a in node.names
        }
    base = "." * node.level + (node.module or "")
    return {a.asname or a.name: f"{base}:{a.name}" for a in node.names}


def modules_of(node: ast.Import | ast.ImportFrom) -> list[str]:
    """References to the modules that executing the statement imports."""
    if isinstance(node, ast.Import):
        return [f"{a.name}:" for a in node.names]
    base = "." * node.level + (node.module or "")
    return [f"{base}:{a.name}" for a in node.names]


def children(node: ast.AST) -> list[ast.AST]:
    """The nodes directly in ``node``; faster than ``ast.iter_child_nodes``."""
    found: list[ast.AST] = []
    for name in node._fields:
        value = getattr(node, name, None)
        if type(value) is list:
            found += [item for item in value if isinstance(item, ast.AST)]
        elif isinstance(value, ast.AST):
            found.append(value)
    return found


def _bind(body: Iterable[ast.AST], scope: Scope) -> None:
    outer: set[str] = set()
    stack: list[ast.AST] = list(body)
    while stack:
        node = stack.pop()
        kind = type(node)
        if kind is ast.Name:
            if type(node.ctx) is not ast.Load:
                scope.names.add(node.id)
        elif kind in _LEAVES:
            continue
        elif kind in _DEFINITIONS:
            scope.names.add(node.name)
            stack += node.decorator_list
        elif kind in _COMPREHENSIONS:
            # Its own scope, but `:=` in it binds here.
            scope.names.update(n.target.id for n in ast.walk(node) if type(n) is ast.NamedExpr)
        elif kind in (ast.Import, ast.ImportFrom):
            scope.imports |= imported(node)
        elif kind in (ast.Global, ast.Nonlocal):
            outer.update(node.names)
        else:
            if kind in _NAMED and node.name:
                scope.names.add(node.name)
            elif kind is ast.MatchMapping and node.rest:
                scope.names.add(node.rest)
            stack += children(node)
    scope.names -= outer
    # A name that is imported and assigned is followed as the import.
    scope.names -= set(scope.imports)
