"""What is found in a piece of source text, and what the names in it stand for."""

from __future__ import annotations

from dataclasses import dataclass, field

from harness.identity.scopes import Scope


@dataclass
class Piece:
    """References, mentions and the text of one normal form."""

    text: list[str] = field(default_factory=list)
    references: dict[str, int] = field(default_factory=dict)
    strong: set[int] = field(default_factory=set)
    """References to what may run; the others only tell types apart, as in ``isinstance``."""
    mentions: set[str] = field(default_factory=set)
    prefixes: set[str] = field(default_factory=set)
    strings: set[str] = field(default_factory=set)
    dynamic: bool = False
    """Whether an attribute is reached by a name that the source text does not show."""
    imports: list[str] = field(default_factory=list)
    figures: int = 0
    """Sum of a hash of every number and comparison: the same however they are arranged."""


@dataclass(frozen=True)
class File:
    """What a writer has to know of the file: its names, and those used as keywords or texts."""

    bindings: dict[str, str]
    """Module-level names; a reference for the imported ones, ``""`` for the file's own."""
    spoken: frozenset[str] = frozenset()


class Names:
    """Looks names up from where they stand, and writes what they stand for."""

    def __init__(self, file: File):
        self.file = file
        self.piece = Piece()
        self.scopes: list[Scope] = []
        self.numbers: dict[tuple[int, str], int] = {}
        self.weak = 0

    def _put(self, text: str) -> None:
        self.piece.text.append(text)

    def _refer(self, reference: str) -> None:
        index = self.piece.references.setdefault(reference, len(self.piece.references))
        if not self.weak:
            self.piece.strong.add(index)
        self._put(f"@{index} ")

    def _name(self, name: str, attributes: list[str]) -> None:
        """``name.attribute...`` where ``name`` is looked up from here."""
        for depth in range(len(self.scopes) - 1, -1, -1):
            scope = self.scopes[depth]
            if scope.kind == "class":
                if depth == len(self.scopes) - 1 and name in scope.names:
                    # It may be a method's, as in `__radd__ = __add__`.
                    self.piece.mentions.add(name)
                    if name in self.file.bindings:  # or of the module, as in `a = a`
                        self._refer(self.file.bindings[name] or f":{name}")
                    self._attributes(f"~{name}", attributes)
                    return
                if name not in scope.imports:
                    continue
            if name in scope.imports:
                self._refer(_extended(scope.imports[name], attributes))
                return
            if name in scope.names:
                self._attributes(self._local(scope, name), attributes)
                return
        if name in self.file.bindings:
            reference = self.file.bindings[name] or f":{name}"
            self._refer(_extended(reference, attributes))
        else:
            self._attributes(f"{name} ", attributes)

    def _local(self, scope: Scope, name: str) -> str:
        if name in scope.kept:
            return f"%{name} "
        key = (id(scope), name)
        return f"%{self.numbers.setdefault(key, len(self.numbers))} "

    def _attributes(self, head: str, attributes: list[str]) -> None:
        self._put(head + "".join(f".{a} " for a in attributes))
        self.piece.mentions.update(attributes)


def _extended(reference: str, attributes: list[str]) -> str:
    if not attributes:
        return reference
    dot = "" if reference.endswith(":") else "."
    return f"{reference}{dot}{'.'.join(attributes)}"
