"""The normal form of a piece of source text: what it computes, whatever it looks like.

Left out are positions, comments, docstrings, annotations of functions, texts of errors, and the
names of locals. A name from outside the piece becomes a reference, ``module:name.attribute`` with
``module`` empty for the file itself; the form holds a placeholder for it, so that a helper may
move and an import be written otherwise. What else the piece says that can decide which code runs,
the attributes it mentions, is collected beside it.
"""

from __future__ import annotations

import ast

from harness.identity import scopes
from harness.identity.nodes import Nodes
from harness.identity.piece import Piece


class Writer(Nodes):
    """Writes one piece. Use :meth:`function`, :meth:`header` or :meth:`statements` once."""

    def statements(self, nodes: list[ast.stmt]) -> Piece:
        """Statements of a module."""
        self._body(nodes)
        return self.piece

    def function(self, node: ast.FunctionDef | ast.AsyncFunctionDef, private: bool) -> Piece:
        """A function or method; the names of parameters count unless it is ``private``."""
        self._function(node, private)
        return self.piece

    def header(self, node: ast.ClassDef, body: list[ast.stmt], annotations: bool) -> Piece:
        """Bases, decorators and the statements ``body`` of a class."""
        self._many("class", [*node.decorator_list, *node.bases])
        for keyword in node.keywords:
            self._put(f" {keyword.arg}=")
            self._node(keyword.value)
        self.scopes.append(scopes.of_class(node))
        for item in body:
            if isinstance(item, ast.AnnAssign) and annotations:
                self._put("\n:")
                self._node(item.target)
                self._annotation(item.annotation)
                if item.value:
                    self._node(item.value)
            else:
                self._statement(item)
        self.scopes.pop()
        return self.piece
