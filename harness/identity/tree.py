"""Modules of ours as units, and what a reference in one of them stands for."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.identity.cache import Cache
from harness.identity.units import CLASS, STATEMENT

INERT_BASES = frozenset(
    """builtins:object abc:ABC typing:Protocol typing:Generic typing:NamedTuple enum:Enum
    typing:TypedDict""".split()
)
"""Bases from outside that call no method of ours by its name."""
BESIDE = "beside_"
"""Begins the name that stands for a folder of lone files."""
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
    attributes: frozenset[str] = frozenset()
    """Of a class: names that its body binds, other than methods."""

    @property
    def key(self) -> tuple[str, str]:
        """``(module, name)``."""
        return self.module, self.name

    def __str__(self) -> str:
        return f"{self.module}:{self.name}"


@dataclass
class Module:
    """A parsed file."""

    name: str
    path: Path
    package: str
    data: dict[str, Any]
    effects: list[str] = field(default_factory=list)


class Tree:
    """Source text below ``roots`` (top package -> its folder), and what is added to them.

    ``cut`` are units (``module:name``) that nothing is followed into, such as tables from which one
    entry is chosen by name; ``registrars`` are functions whose call at the end of an import says
    only that something exists. ``by_name`` are functions that find something by its name: units
    that use one reach all that the texts in them can name, ``by_name[function](text)``.

    Raises:
        InputError: a file that is needed cannot be read or is not valid Python.
    """

    def __init__(
        self,
        roots: Mapping[str, Path],
        cut: Iterable[str] = (),
        registrars: Iterable[str] = (),
        by_name: Mapping[str, Callable[[str], Iterable[str]]] | None = None,
        cache: Cache | None = None,
    ):
        self.roots = dict(roots)
        self.cut = frozenset(cut)
        self.registrars = frozenset(registrars)
        self.by_name = dict(by_name or {})
        self.cache = cache or Cache()
        self._modules: dict[str, Module | None] = {}
        self._units: dict[tuple[str, str], Unit] = {}
        self._imports: dict[str, list[str]] = {}
        self._loaded: dict[str, tuple[frozenset[str], tuple[tuple[str, str], ...]]] = {}
        self._external: dict[tuple[str, str], bool] = {}

    def add_folder(self, folder: Path) -> str:
        """Make the lone files of ``folder`` known, which import each other by their bare names.

        Returns the name that stands for the folder: ``NAME.stem`` is the module of ``stem.py``.
        """
        name = BESIDE + hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:8]
        self.roots[name] = folder.resolve()
        return name

    # --- modules -------------------------------------------------------------------------------

    def module(self, name: str) -> Module | None:
        """The module called ``name`` if it is one of ours."""
        if name not in self._modules:
            self._modules[name] = self._load(name)
        return self._modules[name]

    def _load(self, name: str) -> Module | None:
        top, _, rest = name.partition(".")
        if top not in self.roots:
            return None
        stem = self.roots[top].joinpath(*rest.split(".")) if rest else self.roots[top]
        empty = Module(name, stem, name, {"units": {}, "bindings": {}, "imports": []})
        if top.startswith(BESIDE) and not rest:
            return empty
        for path in (stem / "__init__.py", stem.with_name(stem.name + ".py")):
            if path.is_file():
                return self._parsed(name, path)
        return empty if stem.is_dir() else None

    def _parsed(self, name: str, path: Path) -> Module:
        try:
            data = self.cache.units(path.read_bytes())
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        except (SyntaxError, ValueError) as error:
            line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
            raise InputError(f"{path}{line}: not valid Python: {error}") from None
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        module = Module(name, path, package, data)
        for unit, found in data["units"].items():
            if found["effect"] and f"{name}:{unit}" not in self.cut:
                calls = self.outside_or_ours(module, found.get("calls", ""))
                if calls not in self.registrars:
                    module.effects.append(unit)
        return module

    def outside_or_ours(self, module: Module, reference: str) -> str:
        """``module:name`` that a reference names in the end, ``""`` for none."""
        if not reference:
            return ""
        where, name, rest = self.resolve(module, reference)
        return f"{where}:{name}" if where else rest

    def imported(self, module: Module, references: Iterable[str]) -> list[str]:
        """Modules of ours that import statements execute, packages above them included."""
        found: list[str] = []
        for reference in references:
            base, _, name = reference.partition(":")
            base = self._absolute(module, base)
            names = [base, f"{base}.{name}"] if name else [base]
            for each in names:
                parts = each.split(".")
                found += [".".join(parts[: k + 1]) for k in range(len(parts))]
        return [name for name in dict.fromkeys(found) if self.module(name) is not None]

    def loaded(self, name: str) -> tuple[frozenset[str], tuple[tuple[str, str], ...]]:
        """Modules of ours that an import of ``name`` imports, and the units that this runs."""
        if name not in self._loaded:
            modules: dict[str, None] = {}
            queue = [name]
            while queue:
                each = queue.pop()
                module = self.module(each)
                if each in modules or module is None:
                    continue
                modules[each] = None
                if each not in self._imports:
                    above = [each.rpartition(".")[0]] if "." in each else []
                    self._imports[each] = above + self.imported(module, module.data["imports"])
                queue += self._imports[each]
            effects = [(m, unit) for m in modules for unit in self._modules[m].effects]
            self._loaded[name] = frozenset(modules), tuple(effects)
        return self._loaded[name]

    # --- references ----------------------------------------------------------------------------

    def _absolute(self, module: Module, base: str) -> str:
        level = len(base) - len(base.lstrip("."))
        if not level:
            top = module.name.partition(".")[0]
            if top.startswith(BESIDE) and base.partition(".")[0] not in self.roots:
                return f"{top}.{base}" if self.module(f"{top}.{base}") else base
            return base
        parents = module.package.split(".") if module.package else []
        parents = parents[: len(parents) - level + 1]
        return ".".join([*parents, *([base[level:]] if base[level:] else [])])

    def resolve(self, module: Module, reference: str) -> tuple[str, str, str]:
        """``(module, unit, rest)`` of what is ours, ``("", "", name)`` of what is not.

        The unit is empty where a whole module is meant.
        """
        base, _, chain = reference.partition(":")
        parts = chain.split(".") if chain else []
        where = self._absolute(module, base) if base else module.name
        for _ in range(20):  # a chain of imports that is longer goes in a circle
            current = self.module(where)
            if current is None:
                return "", "", ".".join([where, *parts])
            if not parts:
                return where, "", ""
            head = parts[0]
            binding = current.data["bindings"].get(head)
            if binding is None:
                if self.module(f"{where}.{head}") is None:
                    return "", "", ".".join([where, *parts])
                where, parts = f"{where}.{head}", parts[1:]
            elif binding.startswith("="):
                return self._inner(current, binding[1:], parts[1:])
            else:
                base, _, chain = binding.partition(":")
                parts = [*(chain.split(".") if chain else []), *parts[1:]]
                where = self._absolute(current, base) if base else where
        return "", "", ".".join([where, *parts])

    @staticmethod
    def _inner(module: Module, unit: str, rest: list[str]) -> tuple[str, str, str]:
        """Follow nested classes."""
        units = module.data["units"]
        while rest and units.get(f"{unit}.{rest[0]}", {}).get("kind") == CLASS:
            unit, rest = f"{unit}.{rest[0]}", rest[1:]
        return module.name, unit, ".".join(rest)

    # --- units ---------------------------------------------------------------------------------

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
        if data is None or data["kind"] not in ("value", STATEMENT) or key in seen:
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
