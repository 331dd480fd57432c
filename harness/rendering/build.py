"""Scene descriptions as Mitsuba scenes: what their effects call for is built, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from harness.core.protocol.disk import REC709
from harness.effects.base import Recipe
from harness.geometry.primitives import MaterialSpec, Mesh, Sphere
from harness.geometry.shapes import sphere_mesh
from harness.microgeometry.walks.meshes import Part
from harness.scenes.base import AreaLamp, Camera, PointLamp, Scene

_WEIGHTS = np.array(REC709)
_NONE: Mapping[str, np.ndarray] = MappingProxyType({})
_BLACK = {
    "name": "lamp",
    "type": "mitsuba",
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
}

Around = Callable[[MaterialSpec | None], mi.BSDF]
"""The BSDF of a shape that does not carry the material under test."""


def integrator(recipe: Recipe) -> mi.Integrator:
    """Moments of Mitsuba's leanest integrator that does what ``recipe`` says.

    Direct light by one sample of the BSDF, with ``emitter_sampling`` one of the light too,
    both weighted by the power heuristic. Mitsuba counts the light itself as a path's first
    vertex, so its depth is one more than the bounces.
    """
    nested: dict[str, Any] = {"type": recipe.integrator, "hide_emitters": True}
    if recipe.integrator == "direct":
        nested |= {"bsdf_samples": 1, "emitter_samples": int(recipe.emitter_sampling)}
    else:
        nested |= {"max_depth": recipe.bounces + 1}
    return mi.load_dict({"type": "moment", "nested": nested})


def build(
    scene: Scene,
    bsdf: mi.BSDF,
    resolution: int,
    recipe: Recipe,
    around: Around,
    counted: bool = False,
) -> mi.Scene:
    """The scene with ``bsdf`` on its tested shapes and ``resolution`` pixels across.

    ``counted``: with lights that a meter can be put on.
    """
    description: dict[str, Any] = {
        "type": "scene",
        "sensor": _camera(scene.camera, resolution, recipe),
    }
    if "environment" in recipe.lights:
        light = _environment(scene.environment, recipe.channels)
        description["environment"] = _counted(light) if counted else light
    for i, lamp in enumerate(scene.lamps):
        if isinstance(lamp, AreaLamp) and "area-lights" in recipe.lights:
            description[f"lamp{i}"] = _area(lamp, around(_BLACK), recipe.channels, counted)
        elif isinstance(lamp, PointLamp) and "point-lights" in recipe.lights:
            light = {
                "type": "point",
                "position": list(lamp.position),
                "intensity": _colour(lamp.intensity, recipe.channels),
            }
            description[f"lamp{i}"] = _counted(light) if counted else light
    for i, shape in enumerate(scene.shapes):
        material = bsdf if shape.tested else around(shape.material)
        mesh = sphere_mesh(shape) if isinstance(shape, Sphere) else shape
        description[f"shape{i}"] = mesh_of(f"shape{i}", mesh, material)
    return mi.load_dict(description)


def film(width: int, height: int) -> dict[str, Any]:
    """A box filter keeps pixels independent, so that their variances mean what they say."""
    return {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "pixel_format": "rgb",
        "rfilter": {"type": "box"},
    }


def _camera(camera: Camera, resolution: int, recipe: Recipe) -> dict[str, Any]:
    sensor = {
        "type": "thinlens" if recipe.lens else "perspective",
        "fov": camera.fov,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=list(camera.origin), target=list(camera.target), up=list(camera.up)
        ),
        "film": film(resolution, max(1, round(resolution / camera.aspect))),
    }
    if recipe.lens:
        sensor |= {"aperture_radius": camera.aperture, "focus_distance": camera.focus}
    return sensor


def _counted(light: dict[str, Any]) -> dict[str, Any]:
    return {"type": "counted-light", "nested": light}


def _environment(environment: float | np.ndarray | None, channels: int) -> dict[str, Any]:
    if not isinstance(environment, np.ndarray):
        return {"type": "constant", "radiance": _colour([environment] * 3, 3)}
    if channels == 1:
        environment = environment @ _WEIGHTS
        environment = np.repeat(environment[..., None], 3, -1)
    return {"type": "envmap", "bitmap": mi.Bitmap(environment.astype(np.float32))}


def _area(lamp: AreaLamp, bsdf: mi.BSDF, channels: int, counted: bool) -> dict[str, Any]:
    """Mitsuba's rectangle is [-1, 1]^2 and faces +z, as a camera's image does."""
    place = mi.ScalarTransform4f().look_at(
        origin=list(lamp.center), target=list(lamp.to), up=list(lamp.up)
    )
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale([lamp.size[0] / 2, lamp.size[1] / 2, 1]),
        "bsdf": bsdf,
        "emitter": {
            "type": "counted-area" if counted else "area",
            "radiance": _colour(lamp.radiance, channels),
        },
    }


def _colour(rgb: Any, channels: int) -> dict[str, Any]:
    rgb = [float(v) for v in rgb]
    return {"type": "rgb", "value": rgb if channels == 3 else [float(np.dot(rgb, _WEIGHTS))] * 3}


def mesh_of(
    name: str, mesh: Mesh | Part, bsdf: Any, colours: Mapping[str, np.ndarray] = _NONE
) -> mi.Mesh:
    """Mitsuba's mesh of vertices, faces, normals and uv; ``colours`` [V, 3] by attribute."""
    props = mi.Properties()
    props["bsdf"] = bsdf
    built = mi.Mesh(
        name,
        vertex_count=len(mesh.vertices),
        face_count=len(mesh.faces),
        has_vertex_normals=mesh.normals is not None,
        has_vertex_texcoords=True,
        props=props,
    )
    for attribute, values in colours.items():
        built.add_attribute(attribute, 3, np.ravel(values).astype(np.float32))
    parameters = mi.traverse(built)
    parameters["vertex_positions"] = np.ravel(mesh.vertices).astype(np.float32)
    parameters["faces"] = mi.UInt32(np.ravel(mesh.faces).astype(np.uint32))
    parameters["vertex_texcoords"] = np.ravel(mesh.uv).astype(np.float32)
    if mesh.normals is not None:
        parameters["vertex_normals"] = np.ravel(mesh.normals).astype(np.float32)
    parameters.update()
    dr.eval(parameters["vertex_positions"])
    return built
