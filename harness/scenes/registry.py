"""Finds scenes: the named ones, or a user's own Mitsuba XML.

A specification is a name, or a mapping::

    {name: studio-sphere, texture_repeat: 3, effects: [environment]}
    {name: kitchen, file: kitchen.xml, replace_bsdf: table, effects: [environment]}

A named scene takes the keyword arguments of its function in :mod:`harness.scenes.library`.
Relative files are meant from ``base_dir``, or the working folder.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from harness import mitsuba_xml
from harness.protocol import InputError, nearest
from harness.scenes import effects, library
from harness.scenes.base import Scene, XmlScene
from harness.source import covered, digest

Spec = str | Mapping[str, Any]

_XML_KEYS = ("name", "file", "replace_bsdf", "effects")


def names() -> list[str]:
    """Names of the named scenes, sorted."""
    return sorted(library.SCENES)


def describe(name: str) -> str:
    """One line about a named scene."""
    return inspect.cleandoc(_function(name).__doc__ or "").partition("\n")[0]


def validate(spec: Spec, base_dir: Path | str | None = None) -> None:
    """Refuse a specification that :func:`make` could not follow.

    Raises:
        InputError: with one line that says what is wrong.
    """
    if _is_xml(spec):
        _xml_scene(spec, base_dir)
    else:
        _arguments(spec)


def identity(spec: Spec, base_dir: Path | str | None = None) -> dict[str, Any]:
    """What determines the scene, as JSON data: contents of files, never their paths."""
    if _is_xml(spec):
        scene = _xml_scene(spec, base_dir)
        return {
            "type": "xml",
            "xml": mitsuba_xml.content_hash(scene.file, f"scene '{scene.name}'"),
            "replace_bsdf": scene.replace_bsdf,
            "effects": sorted(scene.effects),
        }
    name, parameters, wanted = _arguments(spec)
    return {
        "type": "named",
        "name": name,
        "parameters": parameters,
        "effects": sorted(wanted),
        "source": digest(covered(Path(library.__file__), "harness.scenes")),
    }


def make(spec: Spec, base_dir: Path | str | None = None) -> Scene | XmlScene:
    """The scene; :class:`InputError` if the specification is refused."""
    if _is_xml(spec):
        return _xml_scene(spec, base_dir)
    name, parameters, wanted = _arguments(spec)
    return replace(_function(name)(**parameters), effects=wanted)


def _is_xml(spec: Spec) -> bool:
    return isinstance(spec, Mapping) and ("file" in spec or "replace_bsdf" in spec)


def _function(name: str) -> Any:
    if name not in library.SCENES:
        raise InputError(f"unknown scene '{name}'{nearest(name, library.SCENES)}")
    return library.SCENES[name]


def _arguments(spec: Spec) -> tuple[str, dict[str, float], tuple[str, ...]]:
    """``(name, all parameters, effects)`` of a named scene's specification."""
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping):
        raise InputError(f"scene: expected a name or a mapping, got {spec!r}")
    name = spec.get("name")
    if not isinstance(name, str):
        raise InputError(f"scene: name: expected the name of a scene, got {name!r}")
    defaults = {k: p.default for k, p in inspect.signature(_function(name)).parameters.items()}
    parameters = dict(defaults)
    for key, value in spec.items():
        if key in ("name", "effects"):
            continue
        if key not in defaults:
            hint = nearest(str(key), ("effects", "file", "name", "replace_bsdf", *defaults))
            raise InputError(f"scene '{name}': unknown key '{key}'{hint}")
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and value > 0):
            raise InputError(f"scene '{name}': {key}: expected a number above 0, got {value!r}")
        parameters[key] = float(value)
    wanted = effects.checked(spec.get("effects", library.EFFECTS), f"scene '{name}'")
    return name, parameters, wanted


def _xml_scene(spec: Spec, base_dir: Path | str | None) -> XmlScene:
    """The user's scene, found to hold the BSDF that is to be replaced."""
    assert isinstance(spec, Mapping)
    file = spec.get("file")
    if not isinstance(file, str) or not file:
        raise InputError(f"scene: file: expected the name of an XML file, got {file!r}")
    name = spec.get("name", Path(file).stem)
    if not isinstance(name, str) or not name:
        raise InputError(f"scene: name: expected a text, got {name!r}")
    where = f"scene '{name}'"
    for key in spec:
        if key not in _XML_KEYS:
            raise InputError(f"{where}: unknown key '{key}'{nearest(str(key), _XML_KEYS)}")
    path = Path(base_dir or "") / file
    root = mitsuba_xml.read(path, where)
    if root.tag != "scene":
        raise InputError(f"{where}: {path}: expected the root <scene>, got <{root.tag}>")
    replaced, known = spec.get("replace_bsdf"), mitsuba_xml.bsdf_ids(root)
    if not isinstance(replaced, str):
        hint = f" (it has {', '.join(known)})" if known else ""
        raise InputError(
            f"{where}: replace_bsdf: expected the id of a BSDF of {path}{hint}, got {replaced!r}"
        )
    if replaced not in known:
        hint = nearest(replaced, known) if known else "; none of its BSDFs has an id"
        raise InputError(f"{where}: {path} has no BSDF of id '{replaced}'{hint}")
    if root.find("sensor") is None:
        raise InputError(f"{where}: {path} has no <sensor>")
    wanted = effects.checked(spec.get("effects", library.EFFECTS), where)
    return XmlScene(name, path, replaced, wanted, f"'{replaced}' of {path.name}")
