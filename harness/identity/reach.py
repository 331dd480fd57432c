"""Which units a computation can reach from where it begins.

Rapid type analysis: a name reaches what it stands for; an attribute ``x.foo`` reaches the method
``foo`` of every class that is named in reached code, for ``x`` may be of any of them. A class that
is named brings its bases, its special methods, and all methods if something outside may call them.
Importing a module runs its statements, so these count for every module that is imported on the way.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from harness.identity.tree import Tree, Unit
from harness.identity.units import CLASS

Key = tuple[str, str]


@dataclass
class Reached:
    """``units`` that are reached, and ``mentions`` of attributes in them.

    ``waiting`` are methods of reached classes that no mention has reached yet, by name.
    """

    units: dict[Key, Unit] = field(default_factory=dict)
    mentions: set[str] = field(default_factory=set)
    prefixes: set[str] = field(default_factory=set)
    waiting: dict[str, list[Key]] = field(default_factory=dict)
    modules: set[str] = field(default_factory=set)


def reach(tree: Tree, entries: Iterable[str], mentions: Iterable[str] = ()) -> Reached:
    """What ``entries`` (``module:unit`` or ``module:Class.method``) reach.

    ``mentions`` are attributes that other code mentions, which reach methods here too.

    Raises:
        KeyError: an entry that does not exist.
    """
    search = _Search(tree)
    for name in mentions:
        search.mention(name)
    for entry in entries:
        search.enter(entry)
    search.run()
    return search.found


class _Search:
    def __init__(self, tree: Tree):
        self.tree = tree
        self.found = Reached()
        self.queue: list[Key] = []
        self.queued: set[Key] = set()

    def enter(self, entry: str) -> None:
        where, name = self.tree.entry(entry)
        self.push((where, name))
        if "." in name:  # a method brings its class
            self.push((where, name.rpartition(".")[0]))

    def push(self, key: Key) -> None:
        if key not in self.queued:
            self.queued.add(key)
            self.queue.append(key)

    def run(self) -> None:
        while self.queue:
            self.visit(self.queue.pop())

    def visit(self, key: Key) -> None:
        unit = self.tree.unit(*key)
        self.found.units[key] = unit
        self.load(unit.module)
        for name in unit.imports:
            self.load(name)
        for target in unit.strong:
            self.push(target)
        for name in unit.mentions:
            self.mention(name)
        for prefix in unit.prefixes:
            self.mention_prefix(prefix)
        if unit.kind == CLASS:
            for method in unit.methods:
                self.method(unit, method)

    def method(self, unit: Unit, name: str) -> None:
        key = (unit.module, f"{unit.name}.{name}")
        if (
            name in unit.always
            or (name.startswith("__") and name.endswith("__"))
            or name in self.found.mentions
            or any(name.startswith(prefix) for prefix in self.found.prefixes)
        ):
            self.push(key)
        else:
            self.found.waiting.setdefault(name, []).append(key)

    def mention(self, name: str) -> None:
        if name not in self.found.mentions:
            self.found.mentions.add(name)
            for key in self.found.waiting.pop(name, ()):
                self.push(key)

    def mention_prefix(self, prefix: str) -> None:
        if prefix not in self.found.prefixes:
            self.found.prefixes.add(prefix)
            for name in [n for n in self.found.waiting if n.startswith(prefix)]:
                for key in self.found.waiting.pop(name):
                    self.push(key)

    def load(self, name: str) -> None:
        """Importing a module runs what it says outside functions, and its own imports."""
        if name not in self.found.modules:
            modules, effects = self.tree.loaded(name)
            self.found.modules |= modules
            for key in effects:
                self.push(key)
