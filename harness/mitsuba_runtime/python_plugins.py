"""A user's own Mitsuba plugins in Python, named ``file.py:Class`` where Mitsuba wants a type.

The class derives from ``mitsuba.BSDF``, ``mitsuba.Texture`` or another kind of plugin, and takes
``mitsuba.Properties``. Its file is imported when a plugin is made, never before.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

from harness.core.classes import declared, read_python
from harness.core.protocol.errors import InputError, nearest
from harness.identity.ours import digest_of_class

KINDS = ("BSDF", "Texture", "Emitter", "Medium", "PhaseFunction", "Shape", "Volume")
"""Mitsuba's classes of which a plugin may be one; each has a ``register_`` of its name."""

_registered: set[str] = set()


def is_own(plugin: str) -> bool:
    """Whether a plugin's type names a Python file."""
    return plugin.rpartition(":")[0].endswith(".py")


def file_of(plugin: str) -> Path:
    """The file that the type names."""
    return Path(plugin.rpartition(":")[0])


def check(plugin: str, where: str) -> None:
    """Refuse a type whose file is not there, no Python, or without that class."""
    file, class_name = file_of(plugin), plugin.rpartition(":")[2]
    if not file.is_file():
        raise InputError(f"{where}: no such file: {file} (expected file.py:Class)")
    try:
        read_python(file)  # says what is wrong if it is not valid Python
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    known = [item.class_name for item in declared(file)]
    if class_name not in known:
        raise InputError(f"{where}: {file} has no class '{class_name}'{nearest(class_name, known)}")


def identity(plugin: str) -> str:
    """What determines the plugin: its class, and the source that its file stands for."""
    class_name = plugin.rpartition(":")[2]
    return f"{digest_of_class(file_of(plugin), class_name)}:{class_name}"


def register(plugin: str, where: str) -> str:
    """Make the class known to Mitsuba, whose variant must be set; the type to name it by."""
    import mitsuba as mi

    check(plugin, where)
    file, class_name = file_of(plugin).resolve(), plugin.rpartition(":")[2]
    # Named by path and content: two files may have classes of one name, and a file may change.
    found = f"{file} {digest_of_class(file, class_name)}"
    name = f"{file.stem}-{class_name}-{hashlib.sha256(found.encode()).hexdigest()[:16]}".lower()
    if name in _registered:
        return name
    try:
        found = getattr(_module(file, name), class_name)
    except (Exception, SystemExit) as error:
        said = f"{type(error).__name__}: {str(error).strip()}".partition("\n")[0]
        raise InputError(f"{where}: cannot import {file}: {said}") from error
    for kind in KINDS:
        if isinstance(found, type) and issubclass(found, getattr(mi, kind)):
            getattr(mi, f"register_{kind.lower()}")(name, found)
            _registered.add(name)
            return name
    raise InputError(
        f"{where}: {file}: {class_name} is no Mitsuba plugin; expected a class that derives from"
        f" one of mitsuba.{', mitsuba.'.join(KINDS)}"
    )


def _module(file: Path, name: str) -> Any:
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # so that it can import its neighbours
    spec = importlib.util.spec_from_file_location(f"harness_plugin_{name}", file)
    assert spec is not None and spec.loader is not None  # a .py file always has both
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[spec.name]
        raise
    return module
