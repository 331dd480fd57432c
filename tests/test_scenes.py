"""The scenes: shapes, light, look-up, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from harness.core.protocol.errors import InputError
from harness.geometry.primitives import Mesh, Sphere
from harness.geometry.shapes import cloth_mesh, sphere_mesh
from harness.geometry.solids import box, panel, ring, runner, turned
from harness.scenes import environment, registry
from harness.scenes.base import Scene, XmlScene

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
    simple = name not in ("shelf", "table-still-life")
    assert (scene.effects == ("environment",)) == simple
    assert any(shape.tested for shape in scene.shapes)
    assert registry.describe(name) and "\n" not in registry.describe(name)
    json.dumps(registry.identity(name))
    assert registry.identity(name) == registry.identity({"name": name})


@pytest.mark.parametrize("name", registry.names())
def test_three_sizes(name):
    """The finer, the more triangles or texels; the framing, the lamps and the materials stay."""
    small, medium, large = (
        registry.make({"name": name, "size": s}) for s in ("small", "medium", "large")
    )
    counts = [_faces(scene) for scene in (small, medium, large)]
    assert counts[0] < counts[1] < counts[2]
    assert small.camera == medium.camera == large.camera and small.lamps == large.lamps
    assert [s.material for s in small.shapes] == [s.material for s in large.shapes]
    assert registry.identity({"name": name, "size": "medium"}) == registry.identity(name)


@pytest.mark.parametrize("name", ["shelf", "table-still-life"])
def test_solids_are_wound_outwards(name):
    """Every shape of the larger scenes; those of several patches or folds too."""
    scene = registry.make({"name": name, "size": "small"})
    assert {s.material for s in scene.shapes if isinstance(s.material, str)} >= {"star-tiles"}
    assert 1 < sum(shape.tested for shape in scene.shapes) < len(scene.shapes) / 2
    for shape in scene.shapes:
        check_mesh(sphere_mesh(shape) if isinstance(shape, Sphere) else shape)
    found = registry.identity(name)
    assert len(found["materials"]) > 5 and all(
        m["type"] == "named" or "bsdf" in m for m in found["materials"]
    )


def test_lathe():
    """A straight profile gives a cylinder: its area, and normals that point away from the axis."""
    mesh = turned([(2.0, 0.0), (2.0, 1.5), (2.0, 3.0)], (1.0, 2.0, 3.0), repeat=2.0)
    check_mesh(mesh)
    assert _area(mesh) == pytest.approx(2 * np.pi * 2 * 3, rel=1e-3)
    out = mesh.vertices - np.array([1.0, 0.0, 3.0])
    np.testing.assert_allclose(mesh.normals[:, [0, 2]], out[:, [0, 2]] / 2, atol=1e-5)
    assert mesh.vertices[:, 1].min() == 2 and mesh.vertices[:, 1].max() == 5
    # Copies of the texture around are whole, so that no seam shows; along, as many as said.
    assert np.ptp(mesh.uv, axis=0) == pytest.approx([round(8 * np.pi), 6], rel=1e-3)


def test_box_and_ring():
    """Areas known: six faces with round edges between them, and a torus."""
    edge, size = 0.1, np.array([1.0, 2.0, 3.0])
    mesh = box(size, (5.0, 0.0, 0.0), edge, turn=30.0, lean=20.0, detail=3.0)
    check_mesh(mesh)
    a, b, c = size - 2 * edge
    flat, edges = 2 * (a * b + b * c + c * a), 2 * np.pi * edge * (a + b + c)
    assert _area(mesh) == pytest.approx(flat + edges + 4 * np.pi * edge**2, rel=1e-3)
    assert mesh.vertices.mean(0) == pytest.approx([5, 0, 0], abs=1e-3)
    torus = ring(1.0, 0.25, (0, 0, 0), tilt=50.0, detail=2.0)
    check_mesh(torus)
    assert _area(torus) == pytest.approx(4 * np.pi**2 * 0.25, rel=2e-3)


def test_panel_and_runner():
    wall = panel((0, 0, 0), (2, 0, 0), (0, 3, 0), repeat=2.0)
    check_mesh(wall)
    assert wall.normals[0] == pytest.approx([0, 0, 1]) and wall.uv.max(0) == pytest.approx([4, 6])
    cloth = runner(2.0, -1.0, 1.0, 0.8, repeat=1.0)
    check_mesh(cloth)
    # It lies on the table, does not cut it, and hangs down in front.
    on_table = cloth.vertices[:, 2] < 1.0
    assert cloth.vertices[on_table & (cloth.vertices[:, 1] > -0.05), 1].min() >= 0.0
    assert cloth.vertices[:, 1].min() == pytest.approx(-0.8 - 0.1, abs=0.05)


def _faces(scene: Scene) -> int:
    """Triangles, and texels of the environment."""
    made = (sphere_mesh(s) if isinstance(s, Sphere) else s for s in scene.shapes)
    return sum(len(mesh.faces) for mesh in made) + np.size(scene.environment)


def _area(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces].astype(float)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(cross, axis=1).sum() / 2)


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
    from harness.mitsuba_runtime import variant

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
