"""The scenes: shapes, light, look-up, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from harness.protocol import InputError
from harness.scenes import Mesh, Scene, Sphere, XmlScene, environment, registry
from harness.scenes.shapes import cloth_mesh, sphere_mesh

XML = """<scene version="3.0.0">
  <sensor type="perspective"/>
  <emitter type="constant"/>
  <bsdf type="diffuse" id="table"/>
  <shape type="sphere"><ref id="table"/></shape>
</scene>"""


def check_mesh(mesh: Mesh) -> None:
    """Indices in range, unit normals, and faces and texture axes that agree with them."""
    assert mesh.faces.max() == len(mesh.vertices) - 1
    assert len(mesh.vertices) == len(mesh.normals) == len(mesh.uv)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    corners, uv = mesh.vertices[mesh.faces].astype(float), mesh.uv[mesh.faces].astype(float)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = mesh.normals[mesh.faces].mean(1)
    assert ((np.cross(e1, e2) * normal).sum(1) > 0).all(), "wound clockwise"
    (u1, v1), (u2, v2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    assert (u1 * v2 - u2 * v1 > 0).all(), "dp_du x dp_dv against the normal"


def test_sphere_mesh():
    sphere = Sphere(center=(1.0, 2.0, 3.0), radius=0.5, uv_scale=(4.0, 2.0))
    mesh = sphere_mesh(sphere)
    check_mesh(mesh)
    offset = mesh.vertices - np.array(sphere.center)
    np.testing.assert_allclose(offset, 0.5 * mesh.normals, atol=1e-6)
    assert mesh.uv.max(0).tolist() == [4, 2]
    # v runs from the south pole to the north pole; u grows along +x where it faces +z.
    assert (np.diff(mesh.normals[np.argsort(mesh.uv[:, 1], kind="stable"), 1]) > -1e-6).all()
    front = mesh.normals[:, 2] > 0.9
    assert np.corrcoef(mesh.uv[front, 0], mesh.normals[front, 0])[0, 1] > 0.9


def test_cloth_mesh_faces_its_camera():
    mesh = cloth_mesh(texture_repeat=3.0)
    check_mesh(mesh)
    camera = registry.make("draped-cloth").camera
    towards = np.array(camera.origin) - mesh.vertices
    assert ((towards * mesh.normals).sum(1) > 0).all()
    assert mesh.uv.min() == 0 and mesh.uv.max() == 3
    # The normals are those of the surface: compare with the faces' own.
    corners = mesh.vertices[mesh.faces].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert (flat * mesh.normals[mesh.faces].mean(1)).sum(1).min() > 0.99


@pytest.mark.parametrize("name", registry.names())
def test_named_scene(name):
    scene = registry.make(name)
    assert isinstance(scene, Scene) and scene.name == name
    assert scene.effects == ("environment",)
    assert any(shape.tested for shape in scene.shapes)
    assert registry.describe(name) and "\n" not in registry.describe(name)
    json.dumps(registry.identity(name))
    assert registry.identity(name) == registry.identity({"name": name})


def test_studio_light():
    light = environment.studio()
    assert light.shape == (128, 256, 3) and light.dtype == np.float32
    assert light.min() > 0 and np.isfinite(light).all()
    assert 50 < light.max() / np.median(light) < 300
    # Texels of a row cover an area in proportion to sin(theta).
    weight = np.sin(np.pi * np.arange(128) / 127)[:, None, None]
    assert 0.3 < (light * weight).sum() / (weight.sum() * 256 * 3) < 1.5


def test_softbox_is_where_it_says():
    d = environment.directions(129, 256)
    cover = environment.softbox(d, azimuth=30, elevation=40, half_size=(0.2, 0.1))
    i, j = np.unravel_index(cover.argmax(), cover.shape)
    a, e = np.deg2rad([30, 40])
    middle = [np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)]
    mean = (d * cover[..., None]).sum((0, 1))
    np.testing.assert_allclose(mean / np.linalg.norm(mean), middle, atol=0.01)
    assert cover.max() == 1 and cover.min() == 0


def test_directions_are_those_of_mitsuba():
    """One bright texel: Mitsuba's radiance peaks in the direction we say."""
    from harness.rendering import variant

    variant.use("cpu")
    import drjit as dr
    import mitsuba as mi

    data = np.zeros((32, 64, 3), np.float32)
    data[9, 40] = 1
    light = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(data)})
    d = environment.directions(32, 64).reshape(-1, 3)
    si = dr.zeros(mi.SurfaceInteraction3f, len(d))
    si.wi = mi.Vector3f(*(-d.T).astype(np.float32))
    seen = light.eval(si).numpy()[0]
    assert seen.argmax() == 9 * 64 + 40
    assert seen.max() == pytest.approx(1, abs=1e-3)


def test_parameters():
    scene = registry.make({"name": "uniform-sphere", "radiance": 2, "texture_repeat": 3})
    assert scene.environment == 2 and scene.shapes[0].uv_scale == (6, 3)
    assert registry.identity({"name": "uniform-sphere", "radiance": 1}) == registry.identity(
        "uniform-sphere"
    )
    assert registry.identity({"name": "uniform-sphere", "radiance": 2}) != registry.identity(
        "uniform-sphere"
    )


def test_xml_scene(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "k.xml").write_text(XML)
    spec = {"name": "kitchen", "file": "k.xml", "replace_bsdf": "table"}
    scene = registry.make(spec, tmp_path / "a")
    assert isinstance(scene, XmlScene)
    assert scene.file == tmp_path / "a" / "k.xml" and scene.replace_bsdf == {"table": "tested"}
    assert registry.identity(spec, tmp_path / "a") == registry.identity(spec, tmp_path / "b")
    (tmp_path / "b" / "k.xml").write_text(XML.replace("sphere", "cube"))
    assert registry.identity(spec, tmp_path / "a") != registry.identity(spec, tmp_path / "b")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("studio-spere", "unknown scene 'studio-spere'; did you mean 'studio-sphere'?"),
        (4, "expected a name or a mapping"),
        ({}, "name: expected the name of a scene"),
        ({"name": "studio-sphere", "radience": 2}, "unknown key 'radience'"),
        ({"name": "uniform-sphere", "radience": 2}, "did you mean 'radiance'"),
        ({"name": "uniform-sphere", "radiance": "2"}, "expected a number above 0"),
        ({"name": "uniform-sphere", "radiance": -1}, "expected a number above 0"),
        ({"name": "uniform-sphere", "size": "lagre"}, "did you mean 'large'"),
        ({"name": "uniform-sphere", "radiance": float("inf")}, "expected a number above 0"),
        ({"name": "studio-sphere", "effects": ["enviroment"]}, "did you mean 'environment'"),
        ({"name": "studio-sphere", "effects": "environment"}, "expected a list"),
        ({"name": "studio-sphere", "effects": []}, "expected at least one"),
        ({"name": "studio-sphere", "effects": [["environment"]]}, "unknown effect"),
        ({"file": "no.xml", "replace_bsdf": "table"}, "no such file"),
        ({"file": 3, "replace_bsdf": "table"}, "expected the name of an XML file"),
        ({"file": "bad.xml", "replace_bsdf": "table"}, "is not XML"),
        ({"file": "bsdf.xml", "replace_bsdf": "table"}, "expected the root <scene>"),
        ({"file": "k.xml", "replace_bsdf": "tabel"}, "did you mean 'table'"),
        ({"file": "k.xml"}, "replace_bsdf: expected the id of a BSDF"),
        ({"file": "k.xml", "replace_bsdf": "table", "effect": []}, "did you mean 'effects'"),
        ({"file": "blind.xml", "replace_bsdf": "table"}, "has no <sensor>"),
    ],
)
def test_refused(spec, message, tmp_path):
    (tmp_path / "k.xml").write_text(XML)
    (tmp_path / "bad.xml").write_text("<scene")
    (tmp_path / "bsdf.xml").write_text('<bsdf version="3.0.0" type="diffuse" id="table"/>')
    (tmp_path / "blind.xml").write_text(
        '<scene version="3.0.0"><bsdf type="diffuse" id="table"/></scene>'
    )
    for call in (registry.validate, registry.identity, registry.make):
        with pytest.raises(InputError) as refused:
            call(spec, tmp_path)
        assert message in str(refused.value) and "\n" not in str(refused.value)
