"""A scene whose tested sheets are laid with the triangles of a microgeometry, by Mitsuba alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from harness.core.protocol.errors import Unsupported
from harness.effects.offer import recipe_of
from harness.geometry.primitives import Mesh
from harness.geometry.sheets import tile_frames
from harness.microgeometry.walks.meshes import Part, parts
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.surface import WalkedSurface
from harness.mitsuba_runtime.bitmaps import with_bitmaps
from harness.rendering import build
from harness.rendering.prepared import Prepared
from harness.scenes.base import Scene

_COLOUR_OF = {
    "diffuse": "reflectance",
    "roughconductor": "specular_reflectance",
    "conductor": "specular_reflectance",
}
"""The parameter that multiplies what a BSDF reflects."""
_TINT = "vertex_tint"


def prepare_tiled(scene: Scene, surface: WalkedSurface, resolution: int) -> Prepared:
    """``surface`` in place of the material under test: one tile, instanced all over its sheets.

    Rendered by Mitsuba's path tracer, with light sampling and up to as many bounces as a walk may
    take; nothing that was learned takes part. Its ``mask`` is empty: the material's own counts.

    Raises:
        Unsupported: the scene's tested shapes are not laid with flat tiles, or a colour on a BSDF
            that has no parameter for it.
    """
    recipe = recipe_of(scene)
    frames = []
    for shape in scene.shapes:
        if not isinstance(shape, Mesh) or not shape.tested:
            raise Unsupported(f"scene '{scene.name}' has other shapes than sheets of tiles")
        try:
            frames.append(tile_frames(shape))
        except ValueError as error:
            raise Unsupported(f"scene '{scene.name}' has no sheet of tiles: {error}") from None
    group: dict[str, Any] = {"type": "shapegroup"}
    group |= {f"part{i}": _mesh(f"part{i}", part) for i, part in enumerate(parts(surface))}
    tile = mi.load_dict(group)
    # Camera and lights as other renders have them.
    bare = build.build(replace(scene, shapes=()), None, resolution, recipe, lambda _: None)
    description: dict[str, Any] = {"type": "scene", "sensor": bare.sensors()[0], "tile": tile}
    description |= {f"light{i}": light for i, light in enumerate(bare.emitters())}
    for i, frame in enumerate(np.concatenate(frames)):
        place = np.vstack([frame, [0, 0, 0, 1]])
        description[f"copy{i}"] = {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(place),
            "tile": tile,
        }
    nested = {"type": "path", "hide_emitters": True, "max_depth": surface.bound + 1}
    integrator = mi.load_dict({"type": "moment", "nested": nested})
    return Prepared(mi.load_dict(description), integrator, None, symbolic=True)


def _mesh(name: str, part: Part) -> mi.Mesh:
    tinted = part.tint is not None
    bsdf = mi.load_dict(with_bitmaps(mi, _bsdf(part.micro, tinted)))
    colours = {_TINT: part.tint * np.array(part.micro.reflectance)} if tinted else {}
    return build.mesh_of(name, part, bsdf, colours)


def _bsdf(micro: MicroBSDF, tinted: bool) -> Mapping[str, Any]:
    """The micro-BSDF with its share of each channel, and the mesh's tint, as its colour."""
    share = [float(v) for v in micro.reflectance]
    if not tinted and share == [1.0, 1.0, 1.0]:
        return dict(micro.bsdf)
    key = _COLOUR_OF.get(micro.bsdf["type"])
    given = micro.bsdf.get(key)
    if key is None or (given is not None and given.get("value") != [1.0, 1.0, 1.0]):
        raise Unsupported(f"{micro.where}: the colour of a '{micro.bsdf['type']}' is its own")
    colour: dict[str, Any] = {"type": "rgb", "value": share}
    if tinted:
        colour = {"type": "mesh_attribute", "name": _TINT}
    return {**micro.bsdf, key: colour}
