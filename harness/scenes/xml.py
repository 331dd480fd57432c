"""A user's own Mitsuba scene: what it has, and what is replaced in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.effects.offer import require_of
from harness.effects.registry import checked
from harness.materials import registry as materials
from harness.mitsuba_runtime import mitsuba_xml
from harness.scenes.base import TESTED, XmlScene

KEYS = ("name", "file", "replace_bsdf", "parameters", "effects")
_KINDS = {
    "environment": ("constant", "envmap", "sky", "sun", "sunsky"),
    "area-lights": ("area",),
    "point-lights": ("point", "spot", "directional", "directionalarea", "projector"),
}
_LENSES = frozenset({"thinlens"})
_CAMERAS = ("perspective", "thinlens", "orthographic")


def light_kind(emitter: Any) -> str:
    """The effect that an emitter's node belongs to; "" for a plugin that is not known here."""
    kind = emitter.props.plugin_name()
    return next((effect for effect, kinds in _KINDS.items() if kind in kinds), "")


def is_xml(spec: Any) -> bool:
    """Whether a specification names a file, and not one of the named scenes."""
    return isinstance(spec, Mapping) and ("file" in spec or "replace_bsdf" in spec)


def make(spec: Mapping[str, Any], base_dir: Path | str | None) -> XmlScene:
    """The user's scene, found to hold the BSDFs that are to be replaced.

    Raises:
        InputError: no such file or id, an unknown key, material or effect, or an effect that
            the file has nothing for.
    """
    file = spec.get("file")
    if not isinstance(file, str) or not file:
        raise InputError(f"scene: file: expected the name of an XML file, got {file!r}")
    name = spec.get("name", Path(file).stem)
    if not isinstance(name, str) or not name:
        raise InputError(f"scene: name: expected a text, got {name!r}")
    where = f"scene '{name}'"
    for key in spec:
        if key not in KEYS:
            raise InputError(f"{where}: unknown key '{key}'{nearest(str(key), KEYS)}")
    path = Path(base_dir or "") / file
    parameters = spec.get("parameters", {})
    source = mitsuba_xml.read(path, where, parameters)
    if source.root != "Scene":
        kind = source.root.lower()
        raise InputError(f"{where}: {path}: expected the root <scene>, got <{kind}>")
    replaced = _replaced(spec.get("replace_bsdf"), source, where, base_dir)
    cameras = [sensor.props.plugin_name() for _, sensor in source.nodes("Sensor")]
    if not cameras:
        raise InputError(f"{where}: {path} has no <sensor>")
    if cameras[0] not in _CAMERAS:
        raise InputError(
            f"{where}: {path}: expected a camera ({', '.join(_CAMERAS)}), got the sensor"
            f" '{cameras[0]}'"
        )
    lights = frozenset(light_kind(emitter) for _, emitter in source.nodes("Emitter")) - {""}
    if not lights:
        known = ", ".join(kind for kinds in _KINDS.values() for kind in kinds)
        raise InputError(f"{where}: {path} has no <emitter> of a type known here ({known})")
    ids = ", ".join(f"'{x}'" for x in replaced)
    scene = XmlScene(
        name,
        path,
        replaced,
        checked(spec.get("effects", _usual(lights)), where),
        f"{ids} of {path.name}",
        lights,
        any(camera in _LENSES for camera in cameras),
        bool(source.nodes("Medium")),
        parameters,
    )
    require_of(scene)
    return scene


def identity(scene: XmlScene, base_dir: Path | str | None) -> dict[str, Any]:
    """What determines the scene, as JSON data: contents of files, never their paths."""
    return {
        "type": "xml",
        "xml": mitsuba_xml.read(
            scene.file, f"scene '{scene.name}'", scene.parameters
        ).content_hash(),
        "replace_bsdf": {
            key: TESTED if spec == TESTED else materials.identity(spec, base_dir)
            for key, spec in scene.replace_bsdf.items()
        },
        "effects": sorted(scene.effects),
    }


def _usual(lights: frozenset[str]) -> list[str]:
    """All the lights that the file has, and what it takes to see them."""
    return sorted(lights | ({"emitter-sampling"} if "point-lights" in lights else set()))


def _replaced(
    given: Any, source: mitsuba_xml.MitsubaFile, where: str, base_dir: Path | str | None
) -> dict[str, Any]:
    """Material specifications by the id of the BSDF that they replace."""
    known, path = source.ids("BSDF"), source.path
    if isinstance(given, str):
        given = [given]
    ids = isinstance(given, list | Mapping) and given and all(isinstance(x, str) for x in given)
    if not ids:
        hint = f" (it has {', '.join(known)})" if known else ""
        raise InputError(
            f"{where}: replace_bsdf: expected the id of a BSDF of {path}{hint}, a list of ids, or"
            f" materials by id, got {given!r}"
        )
    found = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given, TESTED)
    for key, spec in found.items():
        if key not in known:
            hint = nearest(key, known) if known else "; none of its BSDFs has an id"
            raise InputError(f"{where}: {path} has no BSDF of id '{key}'{hint}")
        if spec != TESTED:
            try:
                materials.validate(spec, base_dir)
            except InputError as error:
                raise InputError(f"{where}: replace_bsdf: {key}: {error}") from None
    if TESTED not in found.values():
        raise InputError(
            f"{where}: replace_bsdf: expected one id at least with '{TESTED}', for the material"
            " under test"
        )
    return found
