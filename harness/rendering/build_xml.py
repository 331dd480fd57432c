"""A user's scene file as a Mitsuba scene: BSDFs replaced, and only what its effects call for."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import mitsuba as mi

from harness.core.protocol.errors import InputError
from harness.effects.base import Recipe
from harness.rendering import plugin
from harness.rendering.effect_wrapper import RelayBSDF
from harness.scenes.base import XmlScene
from harness.scenes.xml import light_kind


def build_xml(
    scene: XmlScene,
    bsdfs: Mapping[str, mi.BSDF],
    resolution: int,
    recipe: Recipe,
    relay: Callable[[mi.BSDF], RelayBSDF] | None = None,
    counted: bool = False,
) -> mi.Scene:
    """The user's file with each BSDF whose id is in ``bsdfs`` replaced by that one.

    Camera and geometry stay the file's own, and of the lights, media and lens those that
    ``recipe`` has; integrator and film become those of the harness, with the file's aspect
    ratio and ``resolution`` pixels across. ``relay`` wraps the BSDFs that stay, if it is given;
    ``counted`` makes lights that a meter can be put on.
    """
    tree = ElementTree.parse(scene.file)
    root = tree.getroot()
    _replace(root, bsdfs)
    if relay is not None:
        _wrap_bsdfs(root)
    _remove(root, "emitter", lambda light: light_kind(light) not in {*recipe.lights, ""})
    if counted:
        _wrap_lights(root)
    if not recipe.media:
        _remove(root, "medium", lambda medium: True)
    _remove(root, "integrator", lambda integrator: True)
    for sensor in root.iter("sensor"):
        if sensor.get("type") == "thinlens" and not recipe.lens:
            _pinhole(sensor)
    for film in root.iter("film"):
        _resize(film, resolution)
    # In the file's own folder names of textures and meshes resolve as the user wrote them.
    mi.file_resolver().prepend(str(scene.file.parent.resolve()))
    with tempfile.TemporaryDirectory() as folder, plugin.offered(bsdfs, relay):
        edited = Path(folder) / "scene.xml"
        tree.write(edited)
        try:
            return mi.load_file(str(edited))
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise InputError(f"scene '{scene.file}': Mitsuba cannot load it: {reason}") from None


def _replace(root: Element, bsdfs: Mapping[str, mi.BSDF]) -> None:
    for parent, i, child in _places(root, "bsdf"):
        key = child.get("id", "")
        if key in bsdfs:
            slot = Element("bsdf", type="harness", id=key)
            ElementTree.SubElement(slot, "string", name="key", value=key)
            parent[i] = slot


def _wrap_bsdfs(root: Element) -> None:
    """Put every outermost BSDF of the file's own into a relay that takes over its id."""
    inner = {child for bsdf in root.iter("bsdf") for child in bsdf.iter("bsdf") if child != bsdf}
    for parent, i, child in _places(root, "bsdf"):
        if child.get("type") == "harness" or child in inner:
            continue
        names = {key: child.attrib.pop(key) for key in ("id", "name") if key in child.attrib}
        outer = Element("bsdf", {"type": "harness-relay", **names})
        outer.append(child)
        parent[i] = outer


def _wrap_lights(root: Element) -> None:
    for parent, i, child in _places(root, "emitter"):
        if child.get("type") == "area":
            child.set("type", "counted-area")
            continue
        names = {key: child.attrib.pop(key) for key in ("id", "name") if key in child.attrib}
        outer = Element("emitter", {"type": "counted-light", **names})
        outer.append(child)
        parent[i] = outer


def _places(root: Element, tag: str) -> Iterator[tuple[Element, int, Element]]:
    """``(parent, index, element)`` of all that are there now; each may be replaced."""
    found = [
        (parent, i, child)
        for parent in root.iter()
        for i, child in enumerate(parent)
        if child.tag == tag
    ]
    yield from found


def _remove(root: Element, tag: str, unwanted: Callable[[Element], bool]) -> None:
    """Take elements out, and what refers to them."""
    gone = set()
    for parent, _, child in list(_places(root, tag)):
        if unwanted(child):
            gone.add(child.get("id"))
            parent.remove(child)
    for parent, _, child in list(_places(root, "ref")):
        if child.get("id") in gone - {None}:
            parent.remove(child)


def _pinhole(sensor: Element) -> None:
    sensor.set("type", "perspective")
    for child in list(sensor):
        if child.get("name") in ("aperture_radius", "focus_distance"):
            sensor.remove(child)


def _resize(film: Element, resolution: int) -> None:
    size = {e.get("name"): e for e in film if e.get("name") in ("width", "height")}
    width = int(size["width"].get("value")) if "width" in size else 768
    height = int(size["height"].get("value")) if "height" in size else 576
    for child in list(film):
        if child.get("name") in ("width", "height") or child.tag == "rfilter":
            film.remove(child)
    wanted = {"width": resolution, "height": max(1, round(resolution * height / width))}
    for name, value in wanted.items():
        ElementTree.SubElement(film, "integer", name=name, value=str(value))
    ElementTree.SubElement(film, "rfilter", type="box")
