"""Digests of the parts of a computation, from source text alone."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field

from harness.identity.modules import BESIDE
from harness.identity.reach import Key, Reached, reach
from harness.identity.tree import Tree, Unit
from harness.identity.units import STATEMENT

LENGTH = 16


@dataclass(frozen=True)
class Part:
    """A part of a computation: where it begins (``module:name``), and attributes to be reached."""

    entries: tuple[str, ...]
    mentions: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceDigest:
    """``digest`` of all code that a part reaches, and each unit's hash by ``module:name``."""

    digest: str
    units: Mapping[str, str] = field(repr=False)


class Digests:
    """Digests of parts of one tree; parts that meet in many computations are followed once."""

    def __init__(self, tree: Tree):
        self.tree = tree
        self._parts: dict[Hashable, Part] = {}
        self._between: dict[tuple[int, int], frozenset[str]] = {}
        self._reached: dict[tuple[Part, frozenset[str]], Reached] = {}
        self._digests: dict[tuple[Part, frozenset[str], str], SourceDigest] = {}

    def of(
        self, parts: Mapping[str, Part], apart: Mapping[str, tuple[str, str]] | None = None
    ) -> dict[str, SourceDigest]:
        """A digest per part of one computation.

        A method belongs to the part that names its class, whichever part calls it: an attribute
        that one part mentions reaches methods in all. ``apart`` makes parts of their own of what
        is reached only through one attribute, as in ``{"training": ("adapter", "fit")}``.

        Raises:
            KeyError: an entry that does not exist.
        """
        found = self.reached(parts)
        result = {}
        for name, part in parts.items():
            outer, reached = found[name]
            result[name] = self._digest(part, outer, "", reached.units)
            for other, (owner, attribute) in (apart or {}).items():
                if owner == name:
                    rest = self._reach(part, outer - {attribute}).units
                    only = {key: unit for key, unit in reached.units.items() if key not in rest}
                    result[name] = self._digest(part, outer - {attribute}, "", rest)
                    result[other] = self._digest(part, outer, attribute, only)
        return result

    def remembered(self, key: Hashable, make: Callable[[], Part]) -> Part:
        """The part that ``key`` stands for, made when it is first asked for."""
        if key not in self._parts:
            self._parts[key] = make()
        return self._parts[key]

    def reached(self, parts: Mapping[str, Part]) -> dict[str, tuple[frozenset[str], Reached]]:
        """Per part the attributes mentioned elsewhere that count for it, and what it reaches."""
        outer = {name: frozenset[str]() for name in parts}
        while True:
            found = {name: self._reach(part, outer[name]) for name, part in parts.items()}
            grown = False
            for name, one in found.items():
                more = frozenset[str]().union(
                    *(self._called(one, other) for other in found.values() if other is not one)
                )
                if more:
                    outer[name] |= more
                    grown = True
            if not grown:
                return {name: (outer[name], found[name]) for name in parts}

    def _called(self, one: Reached, other: Reached) -> frozenset[str]:
        """Methods that ``one`` does not mention itself and ``other`` does."""
        key = (id(one), id(other))  # both are kept
        if key not in self._between:
            found = one.waiting.keys() & other.mentions
            for prefix in other.prefixes:
                found |= {name for name in one.waiting if name.startswith(prefix)}
            self._between[key] = frozenset(found)
        return self._between[key]

    def _reach(self, part: Part, outer: frozenset[str]) -> Reached:
        key = (part, outer)
        if key not in self._reached:
            self._reached[key] = reach(self.tree, part.entries, {*part.mentions, *outer})
        return self._reached[key]

    def _digest(
        self, part: Part, outer: frozenset[str], only: str, units: Mapping[Key, Unit]
    ) -> SourceDigest:
        key = (part, outer, only)
        if key not in self._digests:
            self._digests[key] = digest_of(units)
        return self._digests[key]


def digest_of(reached: Mapping[Key, Unit]) -> SourceDigest:
    """Of a set of units. Where a unit is does not count, as long as its name says which it is."""
    units = [u for u in reached.values() if u.own]
    shown = {u.key: "<statement>" if u.kind == STATEMENT else u.name for u in units}
    counts = Counter(shown.values())
    several = {key for key, name in shown.items() if counts[name] > 1}

    def display(key: tuple[str, str]) -> str:
        name = shown.get(key, key[1])
        return f"{_module(key[0])}:{name}" if key in several else name

    hashes = {}
    lines = []
    for unit in units:
        targets = [
            display((module, name)) + "." + rest if module else rest
            for module, name, rest in unit.targets
        ]
        one = _hash("\n".join([unit.own, *targets]))
        hashes[str(unit)] = one[:12]
        lines.append(f"{display(unit.key)} {one}")
    return SourceDigest(_hash("\n".join(sorted(lines))), hashes)


def _module(name: str) -> str:
    """Without what stands for a folder, which is another on every machine."""
    return name.partition(".")[2] if name.startswith(BESIDE) else name


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]
