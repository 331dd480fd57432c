"""Writes syntax trees in their normal form; see :mod:`harness.identity.normal_form`."""

from __future__ import annotations

import ast
import re
import zlib

from harness.identity import scopes
from harness.identity.piece import Names

_GETTERS = frozenset({"getattr", "hasattr", "setattr", "delattr"})
_BY_NAME = frozenset({"attrgetter", "methodcaller"})
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
"""A text that can name an attribute, or something in a registry."""
_OMITTED = frozenset({"type_comment", "kind", "ctx", "returns", "annotation", "type_params"})


class Nodes(Names):
    """Writes statements and expressions."""

    def _body(self, nodes: list[ast.stmt]) -> None:
        self._put("{")
        for node in nodes:
            self._statement(node)
        self._put("}")

    def _statement(self, node: ast.stmt) -> None:
        if isinstance(node, ast.Pass | ast.Global | ast.Nonlocal):
            return
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return
        if isinstance(node, ast.Import | ast.ImportFrom):
            self.piece.imports += scopes.modules_of(node)
            return
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                self._put("\n")
                self._generic(ast.Assign(targets=[node.target], value=node.value))
            return
        self._put("\n")
        self._node(node)

    def _many(self, head: str, nodes: list) -> None:
        self._put(f"{head}(")
        for node in nodes:
            self._node(node)
        self._put(")")

    def _node(self, node: ast.AST) -> None:
        special = _SPECIAL.get(type(node))
        if special is not None:
            special(self, node)
        elif isinstance(node, ast.stmt) and isinstance(
            node, ast.Expr | ast.Pass | ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal
        ):
            if isinstance(node, ast.Expr):
                self._many("Expr", [node.value])
        else:
            self._generic(node)

    def _generic(self, node: ast.AST) -> None:
        self._put(f"{type(node).__name__}(")
        for name in node._fields:
            if name in _OMITTED:
                continue
            value = getattr(node, name, None)
            if value is None or value == []:
                continue
            self._put(f"{name}=")
            if isinstance(value, ast.AST):
                self._node(value)
            elif isinstance(value, list):
                if isinstance(value[0], ast.stmt):
                    self._body(value)
                else:
                    for item in value:
                        if isinstance(item, ast.AST):
                            self._node(item)
                        else:
                            self._put(f"{item!r} ")
            else:
                self._put(f"{value!r} ")
        self._put(")")

    def _constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and _NAME.fullmatch(node.value):
            self.piece.strings.add(node.value)
        elif isinstance(node.value, int | float | complex) and not isinstance(node.value, bool):
            self._figure(repr(node.value))
        self._put(f"{node.value!r} ")

    def _compare(self, node: ast.Compare) -> None:
        for operator in node.ops:
            self._figure(type(operator).__name__)
        self._generic(node)

    def _unary(self, node: ast.UnaryOp) -> None:
        self._figure(type(node.op).__name__)
        self._generic(node)

    def _figure(self, text: str) -> None:
        self.piece.figures = (self.piece.figures + zlib.crc32(text.encode())) % 2**32

    def _chain(self, node: ast.Name | ast.Attribute) -> None:
        attributes: list[str] = []
        inner: ast.AST = node
        while isinstance(inner, ast.Attribute):
            attributes.append(inner.attr)
            inner = inner.value
        attributes.reverse()
        if isinstance(inner, ast.Name):
            self._name(inner.id, attributes)
        else:
            self._node(inner)
            self._attributes("", attributes)

    def _call(self, node: ast.Call) -> None:
        function = node.func
        called = function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")
        if called in _GETTERS and len(node.args) > 1:
            self._by_name(node.args[1])
        elif called in _BY_NAME:
            for argument in node.args:
                self._by_name(argument)
        elif called in ("getmembers", "dir"):
            self.piece.dynamic = True
        self._put("Call(")
        self._node(function)
        if called in ("isinstance", "issubclass") and len(node.args) == 2:
            self._node(node.args[0])
            self.weak += 1
            self._node(node.args[1])
            self.weak -= 1
        else:
            for argument in node.args:
                self._node(argument)
        for keyword in node.keywords:
            self._put(f"{keyword.arg or '**'}=")
            self._node(keyword.value)
        self._put(")")

    def _by_name(self, node: ast.AST) -> None:
        """An attribute given as an expression."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            self.piece.mentions.update(node.value.split("."))
        elif (
            isinstance(node, ast.JoinedStr)
            and isinstance(node.values[0], ast.Constant)
            and node.values[0].value
        ):
            self.piece.prefixes.add(str(node.values[0].value))
        else:
            self.piece.dynamic = True

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef, private: bool) -> None:
        self._put("async(" if isinstance(node, ast.AsyncFunctionDef) else "def(")
        for decorator in node.decorator_list:
            self._node(decorator)
        self._inner(node, private)
        self._body(node.body)
        self.scopes.pop()
        self._put(")")

    def _lambda(self, node: ast.Lambda) -> None:
        self._put("lambda(")
        self._inner(node, True)
        self._node(node.body)
        self.scopes.pop()
        self._put(")")

    def _inner(self, node: scopes.Function, private: bool) -> None:
        """Defaults, from outside, and the parameters; leaves the function's scope entered."""
        args = node.args
        for default in [*args.defaults, *args.kw_defaults]:
            if default is None:
                self._put("- ")
            else:
                self._node(default)
        scope = scopes.of_function(node, private, self.file.spoken)
        self.scopes.append(scope)
        for kind, group in (
            ("/", args.posonlyargs),
            ("", args.args),
            ("*", [args.vararg] if args.vararg else []),
            ("=", args.kwonlyargs),
            ("**", [args.kwarg] if args.kwarg else []),
        ):
            for item in group:
                self._put(kind + self._local(scope, item.arg))

    def _nested_function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self._name(node.name, [])
        self._function(node, True)

    def _nested_class(self, node: ast.ClassDef) -> None:
        self._name(node.name, [])
        self._many(f"class {node.name}", [*node.decorator_list, *node.bases])
        self.scopes.append(scopes.of_class(node))
        self._body(node.body)
        self.scopes.pop()

    def _comprehension(
        self, node: ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp
    ) -> None:
        self._put(f"{type(node).__name__}(")
        # The first iterable is evaluated outside.
        self._node(node.generators[0].iter)
        self.scopes.append(scopes.of_comprehension(node.generators))
        for index, generator in enumerate(node.generators):
            self._put("async " if generator.is_async else "for ")
            self._node(generator.target)
            if index:
                self._node(generator.iter)
            for condition in generator.ifs:
                self._many("if", [condition])
        parts = [node.key, node.value] if isinstance(node, ast.DictComp) else [node.elt]
        for part in parts:
            self._node(part)
        self.scopes.pop()
        self._put(")")

    def _raise(self, node: ast.Raise) -> None:
        call = node.exc
        if isinstance(call, ast.Call) and not call.keywords and all(map(_is_text, call.args)):
            # The text of an error is no number.
            self._many("Raise", [call.func])
        else:
            self._generic(node)

    def _assert(self, node: ast.Assert) -> None:
        self._many("Assert", [node.test])

    def _handler(self, node: ast.ExceptHandler) -> None:
        self._put("except(")
        if node.type is not None:
            self.weak += 1
            self._node(node.type)
            self.weak -= 1
        if node.name:
            self._name(node.name, [])
        self._body(node.body)
        self._put(")")

    def _pattern(self, node: ast.MatchAs | ast.MatchStar) -> None:
        self._put(f"{type(node).__name__}(")
        if isinstance(node, ast.MatchAs) and node.pattern is not None:
            self._node(node.pattern)
        if node.name:
            self._name(node.name, [])
        self._put(")")

    def _annotation(self, node: ast.expr) -> None:
        self._put(" annotation ")
        self.weak += 1
        self._node(node)
        self.weak -= 1

    def _annotated(self, node: ast.AnnAssign) -> None:
        self._statement(node)


_SPECIAL = {
    ast.Name: Nodes._chain,
    ast.Attribute: Nodes._chain,
    ast.Constant: Nodes._constant,
    ast.Call: Nodes._call,
    ast.Compare: Nodes._compare,
    ast.UnaryOp: Nodes._unary,
    ast.FunctionDef: Nodes._nested_function,
    ast.AsyncFunctionDef: Nodes._nested_function,
    ast.ClassDef: Nodes._nested_class,
    ast.Lambda: Nodes._lambda,
    ast.ListComp: Nodes._comprehension,
    ast.SetComp: Nodes._comprehension,
    ast.DictComp: Nodes._comprehension,
    ast.GeneratorExp: Nodes._comprehension,
    ast.Raise: Nodes._raise,
    ast.Assert: Nodes._assert,
    ast.ExceptHandler: Nodes._handler,
    ast.MatchAs: Nodes._pattern,
    ast.MatchStar: Nodes._pattern,
    ast.AnnAssign: Nodes._annotated,
}


def _is_text(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _is_text(node.left) and _is_text(node.right)
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
