"""Scene descriptions as Mitsuba scenes."""

from __future__ import annotations

import hashlib
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from harness.protocol import InputError
from harness.scenes.base import Mesh, Scene, Sphere, XmlScene
from harness.scenes.shapes import sphere_mesh

Sampling = Literal["bsdf", "mis"]
_EMITTER_SAMPLES = {"bsdf": 0, "mis": 1}
_UNTESTED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.3}}


def integrator(sampling: Sampling = "bsdf") -> mi.Integrator:
    """Moments of direct light.

    By one sample of the BSDF (``bsdf``), or by that and one of the light, weighted by the
    power heuristic (``mis``).
    """
    nested = {
        "type": "direct",
        "bsdf_samples": 1,
        "emitter_samples": _EMITTER_SAMPLES[sampling],
        "hide_emitters": True,
    }
    return mi.load_dict({"type": "moment", "nested": nested})


def build(scene: Scene, bsdf: mi.BSDF, resolution: int) -> mi.Scene:
    """The scene with ``bsdf`` on its tested shapes and ``resolution``^2 pixels."""
    camera = scene.camera
    description: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": camera.fov,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=list(camera.origin), target=list(camera.target), up=list(camera.up)
            ),
            "film": _film(resolution),
        },
        "environment": _light(scene.environment),
    }
    for i, shape in enumerate(scene.shapes):
        material = bsdf if shape.tested else mi.load_dict(_UNTESTED)
        description[f"shape{i}"] = _mesh(f"shape{i}", shape, material)
    return mi.load_dict(description)


def build_xml(scene: XmlScene, key: str, resolution: int) -> mi.Scene:
    """The user's file with the BSDF of id ``replace_bsdf`` replaced by the pair offered as ``key``.

    Camera, lights and geometry stay the file's own; integrator and film become those of the
    harness, with the file's aspect ratio and ``resolution`` pixels across.
    """
    tree = ElementTree.parse(scene.file)
    root = tree.getroot()
    for parent in root.iter():
        for i, child in enumerate(parent):
            if child.tag == "bsdf" and child.get("id") == scene.replace_bsdf:
                slot = ElementTree.Element("bsdf", type="harness", id=scene.replace_bsdf)
                ElementTree.SubElement(slot, "string", name="key", value=key)
                parent[i] = slot
    for child in [c for c in root if c.tag == "integrator"]:
        root.remove(child)
    for film in root.iter("film"):
        _resize(film, resolution)
    # In the file's own folder names of textures and meshes resolve as the user wrote them.
    mi.file_resolver().prepend(str(scene.file.parent.resolve()))
    with tempfile.TemporaryDirectory() as folder:
        edited = Path(folder) / "scene.xml"
        tree.write(edited)
        try:
            loaded = mi.load_file(str(edited))
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise InputError(f"scene '{scene.file}': Mitsuba cannot load it: {reason}") from None
    return loaded


def scene_key(*parts: str) -> str:
    """A short name for a material and method pair, as Mitsuba properties allow."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _film(resolution: int) -> dict[str, Any]:
    # A box filter keeps pixels independent, so that their variances mean what they say.
    return {
        "type": "hdrfilm",
        "width": resolution,
        "height": resolution,
        "pixel_format": "rgb",
        "rfilter": {"type": "box"},
    }


def _resize(film: ElementTree.Element, resolution: int) -> None:
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


def _light(environment: float | np.ndarray) -> dict[str, Any]:
    if isinstance(environment, np.ndarray):
        return {"type": "envmap", "bitmap": mi.Bitmap(environment.astype(np.float32))}
    return {"type": "constant", "radiance": {"type": "rgb", "value": float(environment)}}


def _mesh(name: str, shape: Sphere | Mesh, bsdf: Any) -> mi.Mesh:
    mesh = sphere_mesh(shape) if isinstance(shape, Sphere) else shape
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
    parameters = mi.traverse(built)
    parameters["vertex_positions"] = np.ravel(mesh.vertices).astype(np.float32)
    parameters["faces"] = mi.UInt32(np.ravel(mesh.faces).astype(np.uint32))
    parameters["vertex_texcoords"] = np.ravel(mesh.uv).astype(np.float32)
    if mesh.normals is not None:
        parameters["vertex_normals"] = np.ravel(mesh.normals).astype(np.float32)
    parameters.update()
    dr.eval(parameters["vertex_positions"])
    return built
