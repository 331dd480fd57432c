"""Finds scenes: the named ones, or a user's own Mitsuba XML.

A specification is a name, or a mapping::

    {name: studio-sphere, texture_repeat: 3, size: small, effects: [environment]}
    {name: with-mis, scene: studio-sphere, effects: [environment, emitter-sampling]}
    {name: outside, scene: draped-cloth, environment: meadow.exr}
    {name: kitchen, file: kitchen.xml, replace_bsdf: table}
    {file: kitchen.xml, replace_bsdf: {table: tested, cup: suede}, effects: auto}

A named scene takes the keyword arguments of its function in :mod:`harness.scenes.library`;
``scene`` says which it is where ``name`` is another, such as one of several that differ in
their effects. Relative files are meant from ``base_dir``, or the working folder.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.effects.offer import require_of
from harness.effects.registry import checked
from harness.materials import registry as materials
from harness.mitsuba_runtime.mitsuba_xml import file_hash
from harness.scenes import environment_file, library, xml
from harness.scenes.base import Scene, XmlScene
from harness.scenes.sizes import SIZES

Spec = str | Mapping[str, Any]


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
    make(spec, base_dir)


def identity(spec: Spec, base_dir: Path | str | None = None) -> dict[str, Any]:
    """What determines the scene, as JSON data: contents of files, never their paths."""
    return identity_of(spec, make(spec, base_dir), base_dir)


def identity_of(
    spec: Spec, scene: Scene | XmlScene, base_dir: Path | str | None = None
) -> dict[str, Any]:
    """:func:`identity` of a scene that is made already."""
    if isinstance(scene, XmlScene):
        return xml.identity(scene, base_dir)
    _, name, parameters = _arguments(spec)
    found = {
        "type": "named",
        "name": name,
        "parameters": parameters,
        "effects": sorted(scene.effects),
    }
    if isinstance(spec, Mapping) and "environment" in spec:
        file = environment_file.path_of(spec, base_dir)
        found["environment"] = file_hash(file, f"scene '{scene.name}'")
    around = {str(shape.material): shape.material for shape in scene.shapes if shape.material}
    if around:
        found["materials"] = [materials.identity(around[key]) for key in sorted(around)]
    return found


def make(spec: Spec, base_dir: Path | str | None = None) -> Scene | XmlScene:
    """The scene; :class:`InputError` if the specification is refused."""
    if xml.is_xml(spec):
        return xml.make(spec, base_dir)
    shown, name, parameters = _arguments(spec)
    scene = replace(_function(name)(**parameters), name=shown)
    if isinstance(spec, Mapping) and "effects" in spec:
        scene = replace(scene, effects=checked(spec["effects"], f"scene '{shown}'"))
    if isinstance(spec, Mapping) and "environment" in spec:
        scene = environment_file.applied(scene, environment_file.path_of(spec, base_dir))
    require_of(scene)
    return scene


def _function(name: str) -> Any:
    if name not in library.SCENES:
        raise InputError(f"unknown scene '{name}'{nearest(name, library.SCENES)}")
    return library.SCENES[name]


def _arguments(spec: Spec) -> tuple[str, str, dict[str, float | str]]:
    """``(name to show, name of the scene, all its parameters)`` of a specification."""
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping):
        raise InputError(f"scene: expected a name or a mapping, got {spec!r}")
    shown = spec.get("name", spec.get("scene"))
    name = spec.get("scene", shown)
    for key, value in (("name", shown), ("scene", name)):
        if not isinstance(value, str):
            raise InputError(f"scene: {key}: expected the name of a scene, got {value!r}")
    defaults = {k: p.default for k, p in inspect.signature(_function(name)).parameters.items()}
    parameters = dict(defaults)
    where = f"scene '{shown}'"
    for key, value in spec.items():
        if key in ("name", "scene", "effects", "environment"):
            continue
        if key not in defaults:
            known = ("effects", "environment", "file", "name", "replace_bsdf", "scene", *defaults)
            raise InputError(f"{where}: unknown key '{key}'{nearest(str(key), known)}")
        if isinstance(defaults[key], str):
            if value not in SIZES:
                hint = nearest(str(value), SIZES)
                raise InputError(f"{where}: {key}: expected a size, got {value!r}{hint}")
            parameters[key] = value
            continue
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and math.isfinite(value) and value > 0):
            raise InputError(f"{where}: {key}: expected a number above 0, got {value!r}")
        parameters[key] = float(value)
    return shown, name, parameters
