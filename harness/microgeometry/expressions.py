"""The small language in which a description writes its fields.

An expression is Python's arithmetic over numbers, earlier fields and the functions of
:mod:`harness.microgeometry.functions`::

    step(cells(34, seed=23, du=bend, dv=bend).border, 0, 0.2) ** 2 - 0.1 * grain

It is parsed, checked against what exists and then walked; nothing is executed.
"""

from __future__ import annotations

import ast
import inspect
import operator
from collections.abc import Collection, Mapping
from typing import Any, get_type_hints

import numpy as np

from harness.core.protocol.errors import InputError, nearest
from harness.microgeometry.functions import FUNCTIONS

_BINARY = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_UNARY = {ast.USub: operator.neg, ast.UAdd: operator.pos}


class Expression:
    """A parsed expression that refers only to names and functions that there are.

    Raises:
        InputError: it cannot be parsed, or uses what is not known (with the nearest name).
    """

    def __init__(self, text: str | float, known: Collection[str]):
        self.text = str(text)
        try:
            self._tree = ast.parse(self.text.strip(), mode="eval").body
        except (SyntaxError, ValueError) as error:
            reason = error.msg if isinstance(error, SyntaxError) else str(error)
            raise InputError(f"not an expression: {reason}: {self.text}") from None
        self.names: set[str] = set()
        self._check(self._tree, known)

    def __call__(self, size: int, fields: Mapping[str, Any]) -> Any:
        """The value on a grid of ``size``^2 texels: [size, size], or a number."""
        try:
            with np.errstate(all="raise", under="ignore"):
                value = self._value(self._tree, size, fields)
        except (ValueError, TypeError, ArithmeticError, IndexError) as error:
            raise InputError(f"{error}: {self.text}") from None
        if isinstance(value, tuple):
            given = ", ".join(f".{name}" for name in value._fields)
            raise InputError(f"expected one field, so one of {given}: {self.text}")
        return value

    # --- what may be said ----------------------------------------------------------------

    def _check(self, node: ast.AST, known: Collection[str]) -> Any:
        """Refuses ``node`` if it means nothing; gives the type of a call that has parts."""
        match node:
            case ast.Constant(value=int() | float() | str() as value) if type(value) is not bool:
                return None
            case ast.Name(id=name):
                if name not in known:
                    raise InputError(f"unknown field '{name}'{nearest(name, known)}")
                self.names.add(name)
                return None
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                self._check(left, known)
                self._check(right, known)
                return None
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
                return self._check(operand, known)
            case ast.Attribute(value=ast.Call() as call, attr=part):
                parts = getattr(self._check(call, known), "_fields", ())
                if part not in parts:
                    raise InputError(
                        f"{ast.unparse(call.func)}() has no '.{part}'{nearest(part, parts)}"
                    )
                return None
            case ast.Call(func=ast.Name(id=name), args=args, keywords=keywords):
                return self._check_call(name, args, keywords, known)
        raise InputError(
            f"expected numbers, fields, + - * / % ** and functions, got: {ast.unparse(node)}"
        )

    def _check_call(self, name: str, args: Any, keywords: Any, known: Collection[str]) -> Any:
        if name not in FUNCTIONS:
            raise InputError(f"unknown function '{name}'{nearest(name, FUNCTIONS)}")
        function = FUNCTIONS[name]
        parameters = list(inspect.signature(function).parameters)[1:]
        for keyword in keywords:
            if keyword.arg not in parameters:
                hint = nearest(str(keyword.arg), parameters)
                raise InputError(f"{name}(): unknown argument '{keyword.arg}'{hint}")
        try:
            inspect.signature(function).bind(
                0, *args, **{keyword.arg: keyword.value for keyword in keywords}
            )
        except TypeError as error:
            raise InputError(f"{name}(): {error}") from None
        for value in (*args, *(keyword.value for keyword in keywords)):
            self._check(value, known)
        return get_type_hints(function).get("return")

    # --- what it means -------------------------------------------------------------------

    def _value(self, node: ast.AST, size: int, fields: Mapping[str, Any]) -> Any:
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                return fields[name]
            case ast.BinOp(left=left, op=op, right=right):
                one, two = self._value(left, size, fields), self._value(right, size, fields)
                return _BINARY[type(op)](one, two)
            case ast.UnaryOp(op=op, operand=operand):
                return _UNARY[type(op)](self._value(operand, size, fields))
            case ast.Attribute(value=call, attr=part):
                return getattr(self._value(call, size, fields), part)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=keywords):
                positional = [self._value(value, size, fields) for value in args]
                named = {k.arg: self._value(k.value, size, fields) for k in keywords}
                return FUNCTIONS[name](size, *positional, **named)
        raise AssertionError(ast.dump(node))
