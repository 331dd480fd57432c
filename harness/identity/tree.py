"""Units of modules of ours, and what each of them may run or read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from harness.identity.cache import Cache
from harness.identity.modules import Module, Modules
from harness.identity.units import CLASS, STATEMENT, VALUE

INERT_BASES = frozenset(
    """builtins:object abc:ABC typing:Protocol typing:Generic typing:NamedTuple enum:Enum
    typing:TypedDict""".split()
)
"""Bases from outside that call no method of ours by its name."""
_READS_ANNOTATIONS = "typing:NamedTuple"


@dataclass(frozen=True)
class Unit:
    """One unit and what its references stand for; made once, see :meth:`Tree.unit`."""

    module: str
    name: str
    kind: str
    own: str
    """Hash of the normal form."""
    targets: tuple[tuple[str, str, str], ...]
    """Per reference: module and unit of ours, and the attributes after it; or an outside name."""
    strong: tuple[tuple[str, str], ...]
    """Units that it may run or read."""
    mentions: frozenset[str]
    prefixes: tuple[str, ...]
    imports: tuple[str, ...]
    methods: tuple[str, ...] = ()
    always: tuple[str, ...] = ()
    """Of a class: methods that need no mention."""
    figures: int = 0
    """Sum of hashes of the numbers and comparisons in it."""
    attributes: frozenset[str] = frozenset()
    """Of a class: names that its body binds, other than methods."""

    @property
    def key(self) -> tuple[str, str]:
        """``(module, name)``."""
        return self.module, self.name

    def __str__(self) -> str:
        return f"{self.module}:{self.name}"


class Tree(Modules):
    """Modules of ours with their units.

    ``cut`` are units (``module:name``) that nothing is followed into, such as tables from which one
    entry is chosen by name. ``by_name`` are functions that find something by its name: units that
    use one reach all that the texts in them can name, ``by_name[function](text)``.
    """

    def __init__(
        self,
        roots: Mapping[str, Path],
        cut: Iterable[str] = (),
        by_name: Mapping[str, Callable[[str], Iterable[str]]] | None = None,
        cache: Cache | None = None,
    ):
        super().__init__(roots, cut, cache)
        self.by_name = dict(by_name or {})
        self._units: dict[tuple[str, str], Unit] = {}
        self._external: dict[tuple[str, str], bool] = {}

    def unit(self, module: str, name: str) -> Unit:
        """The unit ``name`` of a module of ours; ``KeyError`` if there is none."""
        key = (module, name)
        if key not in self._units:
            self._units[key] = self._linked(module, name)
        return self._units[key]

    def _linked(self, where: str, name: str) -> Unit:
        module = self.module(where)
        if module is None or name not in module.data["units"]:
            raise KeyError(f"{where}:{name}")
        data = module.data["units"][name]
        if f"{where}:{name}" in self.cut:
            return Unit(where, name, data["kind"], "", (), (), frozenset(), (), ())
        external = data["kind"] == CLASS and self.external(where, name)
        targets = tuple(self.resolve(module, reference) for reference in data["references"])
        mentions = set(data["mentions"])
        strong: list[tuple[str, str]] = []
        followed = range(len(targets)) if external else data["strong"]
        for index in followed:
            owner, unit, rest = targets[index]
            if not owner:
                continue
            mentions.update(rest.split(".") if rest else ())
            if unit:
                strong.append((owner, unit))
            else:  # a module as a value: anything in it
                found = self.module(owner)
                strong += [(owner, each) for each in (found.data["units"] if found else ())]
        if data["dynamic"]:
            mentions.update(data["strings"])
            for key in strong:
                mentions.update(self._strings(key, set()))
        always = tuple(data.get("methods", ()) if external else data.get("always", ()))
        for function in {f"{m}:{u}" for m, u in strong} & set(self.by_name):
            texts = set(data["strings"]).union(*(self._strings(k, set()) for k in strong))
            for text in sorted(texts):
                strong += [self.entry(each) for each in self.by_name[function](text)]
        own = data["hash"] if external or "plain" not in data else data["plain"]
        return Unit(
            module=where,
            name=name,
            kind=data["kind"],
            own=own,
            targets=targets,
            strong=tuple(strong),
            mentions=frozenset(mentions),
            prefixes=tuple(data["prefixes"]),
            imports=tuple(self.imported(module, data["imports"])),
            methods=tuple(data.get("methods", ())),
            always=always,
            figures=data["figures"],
            attributes=frozenset(data.get("attributes", ())),
        )

    def entry(self, text: str) -> tuple[str, str]:
        """The unit that ``module:name`` or ``module:Class.method`` names.

        Raises:
            KeyError: there is none.
        """
        where, _, name = text.partition(":")
        module = self.module(where)
        if module is None or name not in module.data["units"]:
            raise KeyError(text)
        return where, name

    def _strings(self, key: tuple[str, str], seen: set[tuple[str, str]]) -> set[str]:
        """Texts of a module-level value, and of the values that it is made of."""
        module = self.module(key[0])
        data = module.data["units"].get(key[1]) if module else None
        if data is None or data["kind"] not in (VALUE, STATEMENT) or key in seen:
            return set()
        seen.add(key)
        found = set(data["strings"])
        for reference in data["references"]:
            owner, unit, _ = self.resolve(module, reference)
            if owner and unit:
                found |= self._strings((owner, unit), seen)
        return found

    def external(self, where: str, name: str) -> bool:
        """Whether a class has a base from outside that may call its methods, or read annotations.

        True as well for bases that cannot be made out.
        """
        key = (where, name)
        if key not in self._external:
            self._external[key] = False  # a circle of bases adds nothing
            module = self.module(where)
            assert module is not None
            self._external[key] = any(
                self._outside(module, base) for base in module.data["units"][name]["bases"]
            )
        return self._external[key]

    def _outside(self, module: Module, base: str) -> bool:
        if base.startswith("builtins:"):
            return base not in INERT_BASES and not base.endswith(("Error", "Exception"))
        owner, unit, rest = self.resolve(module, base)
        if owner:
            found = self.module(owner)
            kind = found.data["units"].get(unit, {}).get("kind") if found else None
            return kind != CLASS or self.external(owner, unit)
        return ":".join(rest.rsplit(".", 1)) not in INERT_BASES - {_READS_ANNOTATIONS}
