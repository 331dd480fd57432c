"""Modules of ours: where they are, what importing one runs, and what a reference stands for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.identity.cache import Cache
from harness.identity.units import CLASS

SHIPPED, CALLED = "harness._methods", "methods"
"""The package that a process imports the shipped methods from, and what identities call it."""
BESIDE = "beside_"
"""Begins the name that stands for a folder of lone files."""


@dataclass
class Module:
    """A parsed file."""

    name: str
    path: Path
    package: str
    data: dict[str, Any]
    effects: list[str] = field(default_factory=list)


def called(name: str) -> str:
    """The name of a module in identities: that of the folder where a shipped method is written."""
    if name == SHIPPED or name.startswith(SHIPPED + "."):
        return CALLED + name.removeprefix(SHIPPED)
    return name


class Modules:
    """Source text below ``roots`` (top package -> its folder), and what is added to them.

    ``cut`` are units (``module:name``) that are not followed.

    Raises:
        InputError: a file that is needed cannot be read or is not valid Python.
    """

    def __init__(
        self, roots: Mapping[str, Path], cut: Iterable[str] = (), cache: Cache | None = None
    ):
        self.roots = dict(roots)
        self.cut = frozenset(cut)
        self.cache = cache or Cache()
        self._modules: dict[str, Module | None] = {}
        self._imports: dict[str, list[str]] = {}
        self._loaded: dict[str, tuple[frozenset[str], tuple[tuple[str, str], ...]]] = {}

    def add_folder(self, folder: Path) -> str:
        """Make the lone files of ``folder`` known, which import each other by their bare names.

        Returns the name that stands for the folder: ``NAME.stem`` is the module of ``stem.py``.
        """
        name = BESIDE + hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:8]
        self.roots[name] = folder.resolve()
        return name

    def module(self, name: str) -> Module | None:
        """The module called ``name`` if it is one of ours."""
        name = called(name)
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
                module.effects.append(unit)
        return module

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

    def _absolute(self, module: Module, base: str) -> str:
        return called(self._written_out(module, base))

    def _written_out(self, module: Module, base: str) -> str:
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
