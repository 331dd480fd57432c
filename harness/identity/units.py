"""A source file as units: its functions, classes, methods, module-level values and statements.

Each unit has a hash of its normal form and what it refers to. The result is JSON data, so that it
can be kept on disk; see :mod:`harness.identity.cache`.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from typing import Any

from harness.identity import scopes
from harness.identity.normal_form import Writer
from harness.identity.piece import File, Piece
from harness.identity.scopes import children

FUNCTION, CLASS, VALUE, STATEMENT = "function", "class", "value", "statement"

PURE_DECORATORS = frozenset(
    """property staticmethod classmethod dataclass dataclasses.dataclass abstractmethod
    abc.abstractmethod cache lru_cache cached_property functools.cache functools.lru_cache
    functools.cached_property functools.wraps functools.total_ordering wraps total_ordering
    contextmanager contextlib.contextmanager torch.no_grad torch.inference_mode torch.enable_grad
    dr.syntax drjit.syntax typing.override override typing.final final typing.runtime_checkable
    runtime_checkable typing.overload overload""".split()
)
"""Decorators that register nothing and call nothing when the module is imported."""


def units_of(text: str) -> dict[str, Any]:
    """The units of a source text.

    Returns ``{"units": {name: unit}, "bindings": {name: reference}, "imports": [module]}``. A unit
    has ``kind``, ``hash``, ``references``, ``strong`` (indices of references to what may run),
    ``mentions``, ``prefixes``, ``strings``, ``dynamic``, ``imports``, ``figures`` (sum of hashes of
    its numbers and comparisons), ``lines`` (first and last of each statement) and ``effect``:
    whether importing the module runs it for more than its name. A class has ``bases``, ``methods``,
    ``always`` (methods that need no mention to be called) and ``attributes``.

    Raises:
        SyntaxError, ValueError: ``text`` is not valid Python.
    """
    return _Splitter(ast.parse(text)).result()


class _Splitter:
    def __init__(self, tree: ast.Module):
        self.tree = tree
        self.units: dict[str, dict[str, Any]] = {}
        self.bindings: dict[str, str] = {}
        self.imports: list[str] = []
        self.values: dict[str, list[ast.stmt]] = {}
        self.unit_of: dict[str, str] = {}

    def result(self) -> dict[str, Any]:
        statements = list(self._bind(self.tree.body, False))
        self.file = File(dict(self.bindings), _spoken(self.tree))
        loose: list[ast.stmt] = []
        for node in statements:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                self._function(node.name, node, node.name.startswith("_"))
            elif isinstance(node, ast.ClassDef):
                self._class(node.name, node)
            else:
                loose.append(node)
        self._values(loose)
        bindings = {
            name: reference or f"={self.unit_of.get(name, name)}"
            for name, reference in self.bindings.items()
        }
        return {"units": self.units, "bindings": bindings, "imports": self.imports}

    def _bind(self, body: list[ast.stmt], typing: bool) -> Iterator[ast.stmt]:
        """Collect bindings; yields what is to become units."""
        for node in body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                for name, reference in scopes.imported(node).items():
                    self.bindings.setdefault(name, reference)
                if not typing:
                    self.imports += scopes.modules_of(node)
            elif isinstance(node, ast.If) and _named(node.test).endswith("TYPE_CHECKING"):
                yield from self._bind(node.body, True)
                yield from self._bind(node.orelse, typing)
            elif typing or _is_nothing(node):
                continue
            else:
                for name in _bound(node):
                    self.bindings[name] = ""
                for inner in ast.walk(node) if isinstance(node, ast.If | ast.Try) else ():
                    # An import that depends on something: what it binds is followed.
                    if isinstance(inner, ast.Import | ast.ImportFrom):
                        self.bindings |= scopes.imported(inner)
                        self.imports += scopes.modules_of(inner)
                yield node

    # --- kinds of units ------------------------------------------------------------------------

    def _function(self, name: str, node: Any, private: bool) -> None:
        piece = Writer(self.file).function(node, private)
        self._add(name, FUNCTION, piece, [node], effect=not _pure(node))

    def _class(self, name: str, node: ast.ClassDef) -> None:
        body, methods, always = [], [], []
        for item in node.body:
            if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
                if item.name not in methods:
                    methods.append(item.name)
                if not _pure(item) or _dunder(item.name):
                    always.append(item.name)
                self._function(f"{name}.{item.name}", item, False)
                self.units[f"{name}.{item.name}"]["effect"] = False
            elif isinstance(item, ast.ClassDef):
                self._class(f"{name}.{item.name}", item)
                methods.append(item.name)
                always.append(item.name)
            else:
                body.append(item)
        piece = Writer(self.file).header(node, body, annotations=True)
        self._add(name, CLASS, piece, [node], effect=not _pure(node))
        unit = self.units[name]
        unit["methods"], unit["always"] = methods, sorted(set(always))
        unit["attributes"] = sorted(scopes.of_class(node).names - set(methods))
        bases = Writer(self.file)
        for base in node.bases:
            bases._node(base.value if isinstance(base, ast.Subscript) else base)
        builtin = [_named(b) for b in node.bases if isinstance(b, ast.Name)]
        unit["bases"] = list(bases.piece.references)
        unit["bases"] += [f"builtins:{b}" for b in builtin if b not in self.bindings]
        if any(isinstance(item, ast.AnnAssign) for item in body) and not node.decorator_list:
            # Annotations count where a base reads them, which only its own file tells.
            plain = Writer(self.file).header(node, body, annotations=False)
            unit["plain"] = _hash(plain)

    def _values(self, statements: list[ast.stmt]) -> None:
        """Assignments to one set of names become one unit, other statements one each."""
        groups: dict[str, list[ast.stmt]] = {}
        loose = []
        for node in statements:
            names = _assigned(node)
            if not names or isinstance(node, ast.AnnAssign) and node.value is None:
                if names:
                    continue
                loose.append(node)
            elif "__all__" not in names:
                owner = next((self.unit_of[n] for n in names if n in self.unit_of), names[0])
                groups.setdefault(owner, []).append(node)
                for name in names:
                    self.unit_of.setdefault(name, owner)
        for name, nodes in groups.items():
            self._add(name, VALUE, Writer(self.file).statements(nodes), nodes)
        for index, node in enumerate(loose):
            unit = f"<{index}>"
            piece = Writer(self.file).statements([node])
            self._add(unit, STATEMENT, piece, [node], effect=True)
            for name in _bound(node):
                self.unit_of.setdefault(name, unit)

    def _add(
        self, name: str, kind: str, piece: Piece, nodes: list[Any], effect: bool = False
    ) -> None:
        unit = {
            "kind": kind,
            "hash": _hash(piece),
            "references": list(piece.references),
            "strong": sorted(piece.strong),
            "mentions": sorted(piece.mentions),
            "prefixes": sorted(piece.prefixes),
            "strings": sorted(piece.strings),
            "dynamic": piece.dynamic,
            "imports": piece.imports,
            "figures": piece.figures,
            "effect": effect,
            "lines": [_lines(node) for node in nodes],
        }
        if name in self.units:  # a property and its setter, or a name that is defined twice
            unit = _merged(self.units[name], unit)
        self.units[name] = unit


def _merged(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    shift = len(first["references"])
    joined = {
        **second,
        "hash": hashlib.sha256((first["hash"] + second["hash"]).encode()).hexdigest()[:16],
        "references": first["references"] + second["references"],
        "strong": first["strong"] + [shift + index for index in second["strong"]],
        "dynamic": first["dynamic"] or second["dynamic"],
        "effect": first["effect"] or second["effect"],
        "figures": (first["figures"] + second["figures"]) % 2**32,
    }
    for key in ("mentions", "prefixes", "strings", "imports"):
        joined[key] = sorted({*first[key], *second[key]})
    joined["lines"] = first["lines"] + second["lines"]
    return joined


def _lines(node: Any) -> tuple[int, int]:
    """First and last line, decorators included."""
    first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", ()))])
    return first, node.end_lineno


def _hash(piece: Piece) -> str:
    return hashlib.sha256("".join(piece.text).encode()).hexdigest()[:16]


def _spoken(tree: ast.Module) -> frozenset[str]:
    """Names that the file gives as keywords, or has as texts."""
    found: set[str] = set()
    stack: list[ast.AST] = [tree]
    while stack:
        node = stack.pop()
        if type(node) is ast.keyword:
            if node.arg:
                found.add(node.arg)
        elif type(node) is ast.Constant:
            if type(node.value) is str:
                found.add(node.value)
            continue
        stack += children(node)
    return frozenset(found)


def _pure(node: Any) -> bool:
    """Whether all decorators are known to do nothing else than wrap."""
    for decorator in node.decorator_list:
        name = _named(decorator.func if isinstance(decorator, ast.Call) else decorator)
        if name not in PURE_DECORATORS and not name.endswith((".setter", ".getter", ".deleter")):
            return False
    return True


def _named(node: ast.AST) -> str:
    """``a.b.c`` of a chain of names, ``""`` for anything else."""
    if isinstance(node, ast.Attribute):
        head = _named(node.value)
        return f"{head}.{node.attr}" if head else ""
    return node.id if isinstance(node, ast.Name) else ""


def _dunder(name: str) -> bool:
    return name.startswith("__") and name.endswith("__")


def _is_nothing(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, or for a module that is run as a script."""
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Compare) and _named(node.test.left) == "__name__"
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _bound(node: ast.stmt) -> list[str]:
    """Names that a module-level statement binds."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    scope = scopes.Scope("function")
    scopes._bind([node], scope)
    return sorted(scope.names)


def _assigned(node: ast.stmt) -> list[str]:
    """Names of a plain assignment to names; empty for any other statement."""
    if isinstance(node, ast.AnnAssign):
        targets: list[ast.expr] = [node.target]
    elif isinstance(node, ast.Assign):
        targets = node.targets
    else:
        return []
    names = []
    for target in targets:
        items = target.elts if isinstance(target, ast.Tuple | ast.List) else [target]
        for item in items:
            if not isinstance(item, ast.Name):
                return []
            names.append(item.id)
    return names
