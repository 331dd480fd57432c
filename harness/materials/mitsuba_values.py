"""A suite's dictionary of JSON data, checked, and as Mitsuba's own: colours and transforms.

A list of three numbers is a colour. ``filename`` is that of a file, and a type may be that of a
plugin of the user's own (``file.py:Class``). Under a key that begins with ``to_`` stands a
transform: a mapping of steps (``{scale: 8}``, ``{scale: [4, 2], rotate: {z: 1, angle: 30},
translate: [0.5, 0]}``), a list of such mappings, or a matrix, row by row (9 numbers for textures,
or 16). Steps are applied one after the other, as written, and as in Mitsuba's XML.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from harness.core.protocol.errors import InputError, nearest
from harness.materials.kinds.base import is_number
from harness.mitsuba_runtime import python_plugins

STEPS = ("scale", "translate", "rotate", "matrix", "look_at")


def checked(node: Any, where: str, base: Path) -> Any:
    """A copy with absolute names of files and plugins, and matrices of transforms [4][4].

    Raises:
        InputError: no type, no such file or plugin, or what is no data of a dictionary.
    """
    if isinstance(node, Mapping):
        if not isinstance(node.get("type"), str):
            raise InputError(f"{where}: expected the key 'type' to name a Mitsuba plugin")
        return {key: _entry(key, value, where, base) for key, value in node.items()}
    if isinstance(node, list) and all(is_number(item) for item in node):
        return list(node)
    if isinstance(node, str | bool) or is_number(node):
        return node
    raise InputError(
        f"{where}: expected a number, a text, true, false, a list of numbers or a mapping,"
        f" got {node!r}"
    )


def _entry(key: Any, value: Any, where: str, base: Path) -> Any:
    if not isinstance(key, str):
        raise InputError(f"{where}: expected a text as key, got {key!r}")
    here = f"{where}.{key}"
    if key == "filename":
        if not isinstance(value, str) or not (base / value).is_file():
            raise InputError(f"{here}: no such file: {value}")
        return str((base / value).resolve())
    if key == "type" and python_plugins.is_own(value):
        plugin = str((base / value).resolve())
        python_plugins.check(plugin, here)
        return plugin
    if is_transform(key, value):
        return matrix(value, here).tolist()
    return checked(value, here, base)


def replaced(
    node: Any, on_file: Callable[[Path, str], Any], on_plugin: Callable[[str], str], where: str = ""
) -> Any:
    """A copy of what :func:`checked` gave with other names of its files and own plugins."""
    if not isinstance(node, Mapping):
        return node
    found = {}
    for key, value in node.items():
        if key == "filename":
            found[key] = on_file(Path(value), where)
        elif key == "type" and python_plugins.is_own(value):
            found[key] = on_plugin(value)
        else:
            found[key] = replaced(value, on_file, on_plugin, f"{where}.{key}")
    return found


def is_transform(key: str, value: Any) -> bool:
    """Whether an entry of a dictionary stands for a transform."""
    return key.startswith("to_") and not (isinstance(value, Mapping) and "type" in value)


def matrix(value: Any, where: str) -> np.ndarray:
    """The transform's matrix [4, 4], of points in columns.

    Raises:
        InputError: an unknown step, or numbers that are none of its own.
    """
    if isinstance(value, Mapping):
        total = np.eye(4)
        for name, given in value.items():
            if name not in STEPS:
                raise InputError(f"{where}: unknown step '{name}'{nearest(str(name), STEPS)}")
            total = _step(name, given, f"{where}.{name}") @ total
        return total
    if isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        total = np.eye(4)
        for i, item in enumerate(value):
            total = matrix(item, f"{where}[{i}]") @ total
        return total
    return _matrix(value, where)


def mitsuba_values(node: Any) -> Any:
    """A copy of a dictionary with Mitsuba's objects in place of lists and transforms."""
    import mitsuba as mi

    if isinstance(node, Mapping):
        if node.get("type") in ("rgb", "srgb"):
            return dict(node)
        return {
            key: mi.ScalarTransform4f(matrix(value, key))
            if is_transform(key, value)
            else mitsuba_values(value)
            for key, value in node.items()
        }
    if isinstance(node, list):
        return {"type": "rgb", "value": node}
    return node


def _step(name: str, given: Any, where: str) -> np.ndarray:
    if name == "matrix":
        return _matrix(given, where)
    if name == "rotate":
        return _rotation(given, where)
    if name == "look_at":
        return _look_at(given, where)
    numbers = [given] * 3 if is_number(given) and name == "scale" else given
    if not _are_numbers(numbers, (2, 3)):
        raise InputError(f"{where}: expected two or three numbers, got {given!r}")
    if len(numbers) == 2:  # of a texture
        numbers = [*numbers, 1.0 if name == "scale" else 0.0]
    total = np.eye(4)
    if name == "scale":
        total[:3, :3] = np.diag(numbers)
    else:
        total[:3, 3] = numbers
    return total


def _rotation(given: Any, where: str) -> np.ndarray:
    """About ``axis``, or ``x``, ``y`` and ``z`` of it, by ``angle`` degrees (Rodrigues)."""
    if not isinstance(given, Mapping):
        given = {"z": 1, "angle": given}
    axis = given.get("axis", [given.get(k, 0) for k in "xyz"])
    angle = given.get("angle")
    length = math.hypot(*axis) if _are_numbers(axis, (3,)) else 0
    known = set(given) <= {"axis", "angle", "x", "y", "z"}
    if not (is_number(angle) and length > 0 and known):
        raise InputError(
            f"{where}: expected degrees, or {{axis: [x, y, z], angle: degrees}}, got {given!r}"
        )
    x, y, z = (v / length for v in axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = math.radians(angle)
    total = np.eye(4)
    total[:3, :3] += math.sin(a) * cross + (1 - math.cos(a)) * cross @ cross
    return total


def _look_at(given: Any, where: str) -> np.ndarray:
    keys = ("origin", "target", "up")
    if not (isinstance(given, Mapping) and set(given) == set(keys)
            and all(_are_numbers(given[key], (3,)) for key in keys)):  # fmt: skip
        raise InputError(f"{where}: expected origin, target and up, three numbers each")
    origin, target, up = (np.array(given[key], float) for key in keys)
    forward = target - origin
    left = np.cross(up, forward)
    if not (np.linalg.norm(forward) > 0 and np.linalg.norm(left) > 0):
        raise InputError(f"{where}: expected a target apart from the origin, and not along up")
    forward, left = forward / np.linalg.norm(forward), left / np.linalg.norm(left)
    total = np.eye(4)
    total[:3] = np.stack([left, np.cross(forward, left), forward, origin], 1)
    return total


def _matrix(value: Any, where: str) -> np.ndarray:
    flat = value
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        flat = [number for row in value for number in row]
    if not _are_numbers(flat, (9, 16)):
        raise InputError(
            f"{where}: expected a transform: {', '.join(STEPS)}, or a matrix of 9 or 16 numbers,"
            f" got {value!r}"
        )
    if len(flat) == 16:
        found = np.array(flat, float).reshape(4, 4)
    else:
        # Of the plane: it goes around the third coordinate.
        found = np.eye(4)
        found[np.ix_([0, 1, 3], [0, 1, 3])] = np.array(flat, float).reshape(3, 3)
    if np.linalg.det(found) == 0:
        raise InputError(f"{where}: the matrix has no inverse")
    return found


def _are_numbers(value: Any, lengths: tuple[int, ...]) -> bool:
    return isinstance(value, list) and len(value) in lengths and all(map(is_number, value))
