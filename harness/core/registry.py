"""Finds methods by name. Importing an adapter waits until it is loaded.

A method is named by

- the ``name`` of a class in a file of ``methods/``,
- an entry point of the group ``harness.methods`` of an installed package, or
- ``path/to/file.py:ClassName``.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import CodeType
from typing import Any

from harness.core.classes import declared, named, read_python
from harness.core.paths import METHODS
from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.method import Method

GROUP = "harness.methods"
METHODS_PACKAGE, IMPORTED_FROM = "methods", "harness._methods"
"""The package of the shipped methods: in identities, and as it is imported. A package called
``methods`` may be anybody's."""


@dataclass(frozen=True)
class Found:
    """Where a method's class is: a file and a class in it, or an entry point."""

    name: str
    class_name: str
    file: Path
    package: str = ""
    summary: str = ""


def names() -> list[str]:
    """All names known here, sorted; nothing is imported."""
    return sorted({*named(METHODS), *_entry_points()})


def find(name: str) -> Found:
    """Where the method called ``name`` is; :class:`InputError` if there is none."""
    if not isinstance(name, str):
        raise InputError(f"expected the name of a method, got {name!r}")
    path, colon, class_name = name.rpartition(":")
    if path.endswith(".py") or name.endswith(".py"):
        return _find_in_file(path if colon else name, class_name if colon else "")
    shipped = named(METHODS)
    if name in shipped:
        item = shipped[name]
        return Found(name, item.class_name, item.file, METHODS_PACKAGE, item.summary)
    broken = METHODS / f"{name.replace('-', '_')}.py"
    if broken.is_file() and not broken.name.startswith("_"):
        read_python(broken)  # says what is wrong if it is not valid Python
        raise InputError(f"{broken}: expected a class with name = '{name}'")
    points = _entry_points()
    if name in points:
        return _find_entry_point(points[name])
    raise InputError(f"unknown method '{name}'{nearest(name, names())}")


def describe(name: str) -> str:
    """One line about the method, from its docstring; or why it cannot be used."""
    try:
        return find(name).summary
    except InputError as error:
        # One that is broken, of a package that is installed: the others are there all the same.
        return f"(broken: {error})"


def load(name: str) -> type[Method]:
    """Import the method's class; :class:`InputError` if that fails or it is no Method."""
    found = find(name)
    try:
        module = _import(found)
    except (Exception, SystemExit) as error:
        what = f"cannot import {found.file}: {oneline(error)}"
        raise InputError(f"method '{name}': {what}") from error
    loaded = getattr(module, found.class_name, None)
    if not (isinstance(loaded, type) and issubclass(loaded, Method)):
        raise InputError(f"method '{name}': {found.class_name} is not a subclass of harness.Method")
    if missing := sorted(loaded.__abstractmethods__):
        raise InputError(
            f"method '{name}': {found.class_name} does not define {', '.join(missing)}"
        )
    return loaded


def make(spec: str | Mapping[str, Any], **params: Any) -> Method:
    """A new method, from its name or from ``{name, params}``."""
    if isinstance(spec, Mapping):
        params = {**spec.get("params", {}), **params}
        spec = spec["name"]
    loaded = load(spec)
    check_parameters(spec, loaded, params)
    try:
        method = loaded(**params)
    except (Exception, SystemExit) as error:
        given = ", ".join(f"{key}={value!r}" for key, value in params.items())
        what = f"{loaded.__name__}({given}): {oneline(error)}"
        raise InputError(f"method '{spec}': {what}") from error
    if not method.name:
        # A short adapter need not name itself.
        method.name = find(spec).name  # type: ignore[misc]
    return method


def check_parameters(name: str, loaded: type[Method], params: Mapping[str, Any]) -> None:
    """Refuse parameters that the constructor does not have."""
    signature = inspect.signature(loaded).parameters.values()
    if any(item.kind is inspect.Parameter.VAR_KEYWORD for item in signature):
        return
    known = [item.name for item in signature]
    for key in params:
        if key not in known:
            hint = nearest(key, known) or "; it takes none"
            raise InputError(f"method '{name}': unknown parameter '{key}'{hint}")


def oneline(error: BaseException) -> str:
    """``Type: first line of the message``."""
    text = str(error).strip().partition("\n")[0]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _entry_points() -> dict[str, EntryPoint]:
    return _found_by(entry_points)


@cache
def _found_by(look_up: Callable[..., Iterable[EntryPoint]]) -> dict[str, EntryPoint]:
    """Once: all packages there are would be read for each method that is not known."""
    return {point.name: point for point in look_up(group=GROUP)}


def _find_in_file(path: str, class_name: str) -> Found:
    file = Path(path).expanduser()
    if not file.is_file():
        raise InputError(f"no such file: {path} (expected path/to/file.py:ClassName)")
    file = file.resolve()
    read_python(file)  # says what is wrong if it is not valid Python
    classes = declared(file)
    for item in classes:
        if item.class_name == class_name:
            return Found(item.name or class_name, class_name, file, "", item.summary)
    known = [item.class_name for item in classes]
    if not class_name:
        listed = f" ({', '.join(known)})" if known else ""
        raise InputError(f"{path}: expected path/to/file.py:ClassName; name one class{listed}")
    raise InputError(f"{path}: no class '{class_name}'{nearest(class_name, known)}")


def _find_entry_point(point: EntryPoint) -> Found:
    try:
        spec = importlib.util.find_spec(point.module)
    except (Exception, SystemExit) as error:
        what = f"cannot import {point.module}: {oneline(error)}"
        raise InputError(f"method '{point.name}': {what}") from error
    if spec is None or spec.origin is None or not point.attr:
        raise InputError(f"method '{point.name}': entry point '{point.value}' names no class")
    file = Path(spec.origin)
    package = point.module if file.name == "__init__.py" else point.module.rpartition(".")[0]
    summary = next((c.summary for c in declared(file) if c.class_name == point.attr), "")
    return Found(point.name, point.attr, file, package, summary)


def _import(found: Found) -> Any:
    """The module that holds the class, imported under its proper name where it has one."""
    if found.package:
        shipped = found.file.parent == METHODS
        package = IMPORTED_FROM if shipped else found.package
        name = found.file.stem if found.file.name != "__init__.py" else ""
        return importlib.import_module(".".join(filter(None, [package, name])))
    # A lone file: its module name holds its path, so that two files of one name can meet.
    name = f"harness_adapter_{_mark(found.file)}_{found.file.stem}"
    stamp = found.file.stat().st_mtime_ns
    if name in sys.modules and getattr(sys.modules[name], "__stamp__", None) == stamp:
        return sys.modules[name]
    if str(found.file.parent) not in sys.path:
        sys.path.append(str(found.file.parent))  # so that it can import its neighbours
    loader = _FromSource(name, str(found.file))
    spec = importlib.util.spec_from_file_location(name, found.file, loader=loader)
    assert spec is not None  # a .py file always has one
    module = importlib.util.module_from_spec(spec)
    module.__stamp__ = stamp  # type: ignore[attr-defined]
    sys.modules[name] = module
    try:
        loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


class _FromSource(importlib.machinery.SourceFileLoader):
    """Compiles the file as it is now.

    Kept byte code is told from an edit of the same length by whole seconds alone: a run could say
    that the code has changed and measure with the old.
    """

    def get_code(self, fullname: str) -> CodeType:
        """The module's code, of the source."""
        return self.source_to_code(self.get_data(self.path), self.path)


def _mark(file: Path) -> str:
    """What tells two files of one name apart in the name of a module."""
    return hashlib.sha256(str(file).encode()).hexdigest()[:16]
