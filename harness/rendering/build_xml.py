"""A user's scene file as a Mitsuba scene: BSDFs replaced, and only what its effects call for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mitsuba as mi

from harness.effects.base import Recipe
from harness.mitsuba_runtime import mitsuba_xml
from harness.rendering import plugin
from harness.rendering.effect_wrapper import EffectWrapper
from harness.scenes.base import XmlScene
from harness.scenes.xml import light_kind

Reference = mi.Properties.ResolvedReference


def build_xml(
    scene: XmlScene,
    bsdfs: Mapping[str, mi.BSDF],
    resolution: int,
    recipe: Recipe,
    wrap: Callable[[mi.BSDF], EffectWrapper] | None = None,
    counted: bool = False,
) -> mi.Scene:
    """The user's file with each BSDF whose id is in ``bsdfs`` replaced by that one.

    Camera and geometry stay the file's own, and of the lights, media and lens those that
    ``recipe`` has. Integrator, sampler and film become those of the harness, with the aspect
    ratio of what the file's film shows and ``resolution`` pixels across. ``wrap`` wraps the
    BSDFs that stay, if it is given; ``counted`` makes lights that a meter can be put on.
    """
    where = f"scene '{scene.file}'"
    source = mitsuba_xml.read(scene.file, where, scene.parameters)
    state = source.editable()
    _replace(state, bsdfs)
    _remove(state, "Emitter", lambda light: light_kind(light) not in {*recipe.lights, ""})
    if not recipe.media:
        _remove(state, "Medium", lambda medium: True)
    _remove(state, "Integrator", lambda integrator: True)
    # Samples are to be independent, for their variance to be that of the mean.
    _remove(state, "Sampler", lambda sampler: True)
    # By index: a node that Python holds is gone as soon as one is appended.
    for _, sensor in mitsuba_xml.nodes(state, "Sensor"):
        if sensor.props.plugin_name() == "thinlens" and not recipe.lens:
            _pinhole(sensor)
    for i in [i for i, _ in mitsuba_xml.nodes(state, "Sensor")]:
        _film(state, i, resolution)
    if wrap is not None:
        _wrap_bsdfs(state)
    if counted:
        _wrap_lights(state)
    with plugin.offered(bsdfs, wrap):
        return mitsuba_xml.instantiate(state, scene.file.parent, where)


def _replace(state: Any, bsdfs: Mapping[str, mi.BSDF]) -> None:
    for _, node in mitsuba_xml.nodes(state, "BSDF"):
        key = node.props.id()
        if key in bsdfs:
            props = mi.Properties()
            props.set_plugin_name("harness")
            props.set_id(key)
            props["key"] = key
            node.props = props


def _wrap_bsdfs(state: Any) -> None:
    """Put every outermost BSDF of the file's own into a wrapper that takes its place."""
    outermost = {
        child
        for node in state.nodes
        if node.type != mi.ObjectType.BSDF
        for _, child in mitsuba_xml.references(node)
    }
    places = [
        i
        for i, node in mitsuba_xml.nodes(state, "BSDF")
        if i in outermost and node.props.plugin_name() != "harness"
    ]
    moved = {i: _wrap(state, i, "harness-effect-wrapper") for i in places}
    for i, node in mitsuba_xml.nodes(state, "BSDF"):
        for key, child in mitsuba_xml.references(node):
            # One that stands inside another, too, stays bare there.
            if child in moved and i not in moved:
                node.props[key] = Reference(moved[child])


def _wrap_lights(state: Any) -> None:
    others = []
    for i, node in mitsuba_xml.nodes(state, "Emitter"):
        if node.props.plugin_name() == "area":
            node.props.set_plugin_name("counted-area")
        else:
            others.append(i)
    for i in others:
        _wrap(state, i, "counted-light")


def _wrap(state: Any, index: int, outer: str) -> int:
    """Have a plugin ``outer`` in place of a node, around that one; where the node then is."""
    inner = mi.parser.SceneNode(state.nodes[index])
    name = inner.props.id()
    inner.props.set_id("")
    state.nodes.append(inner)
    place = len(state.nodes) - 1
    props = mi.Properties()
    props.set_plugin_name(outer)
    props.set_id(name)
    props["nested"] = Reference(place)
    state.nodes[index].props = props
    return place


def _remove(state: Any, kind: str, unwanted: Callable[[Any], bool]) -> None:
    """Take nodes out: nothing refers to them any more."""
    gone = {i for i, node in mitsuba_xml.nodes(state, kind) if unwanted(node)}
    for node in state.nodes:
        for key, child in mitsuba_xml.references(node):
            if child in gone:
                del node.props[key]


def _pinhole(sensor: Any) -> None:
    sensor.props.set_plugin_name("perspective")
    for key in ("aperture_radius", "focus_distance"):
        if key in sensor.props:
            del sensor.props[key]


def _film(state: Any, index: int, resolution: int) -> None:
    """A film of the harness's in place of a sensor's, which shows the same part of the world."""
    sensor = state.nodes[index]
    width, height, crop = 768, 576, None  # Mitsuba's own
    for key, child in mitsuba_xml.references(sensor):
        node = state.nodes[child]
        if node.type == mi.ObjectType.Film:
            width, height = node.props.get("width", width), node.props.get("height", height)
            names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
            if any(name in node.props for name in names):
                plain = (0, 0, width, height)
                crop = [node.props.get(n, d) for n, d in zip(names, plain, strict=True)]
            del sensor.props[key]
    box = mitsuba_xml.add(state, "ReconstructionFilter", "box")
    # A box filter keeps pixels independent, so that their variances mean what they say.
    size = {"width": resolution, "height": max(1, round(resolution * height / width))}
    if crop is not None:
        scale = resolution / crop[2]
        size = {"width": round(width * scale), "height": round(height * scale)}
        part = {"crop_offset_x": round(crop[0] * scale), "crop_offset_y": round(crop[1] * scale)}
        part |= {"crop_width": resolution, "crop_height": max(1, round(crop[3] * scale))}
        # Rounded, the part has to lie inside the whole yet.
        size = {
            side: max(length, part[f"crop_offset_{axis}"] + part[f"crop_{side}"])
            for (side, length), axis in zip(size.items(), "xy", strict=True)
        } | part
    film = mitsuba_xml.add(
        state, "Film", "hdrfilm", pixel_format="rgb", rfilter=Reference(box), **size
    )
    state.nodes[index].props["film"] = Reference(film)
