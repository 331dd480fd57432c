"""Sheets of tiles, triangles of walked surfaces, and renders of both beside each other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from harness.analysis.records import patches as records
from harness.core.protocol.errors import Unsupported
from harness.core.record import Raw
from harness.geometry.primitives import Sphere
from harness.geometry.shapes import sphere_mesh
from harness.geometry.sheets import tile_frames, tiled_sheet
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks import surfaces
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.meshes import parts
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.surface import WalkedSurface
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.blocks import Blocks
from tests.measuring import run
from tests.test_walks_measure import matt

variant.use("cpu")


def test_tiles_of_a_sheet_are_squares_that_close():
    for bend, cells in ((0.0, 1), (120.0, 2)):
        mesh = tiled_sheet(4, bend, tilt=30.0, turn=20.0, cells=cells)
        frames = tile_frames(mesh)
        assert len(frames) == 16
        axes = frames[..., :3] / 0.5
        # Rotations: orthogonal, right-handed, of sides 2 / 4.
        np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.tile(np.eye(3), (16, 1, 1)),
                                   atol=1e-5)  # fmt: skip
        assert np.linalg.det(axes) == pytest.approx(1, abs=1e-5)
        # The far corner of a tile is the near corner of the next one along the diagonal.
        ends = frames[..., 3] + frames[..., 0] + frames[..., 1]
        near = np.linalg.norm(ends[:, None] - frames[None, ..., 3], axis=-1)
        assert (near.min(1) < 1e-5).sum() == 9
    normals = tile_frames(tiled_sheet(4, 120.0))[:, :, 2] / 0.5
    turned = np.degrees(np.arctan2(normals[:, 0], normals[:, 2]))
    assert np.unique(np.round(turned)) == pytest.approx([-45, -15, 15, 45])


def test_what_is_no_sheet_of_tiles_is_refused():
    with pytest.raises(ValueError, match="no flat square|not a flat square|no square"):
        tile_frames(sphere_mesh(Sphere(rows=8)))
    mesh = tiled_sheet(2)
    with pytest.raises(ValueError, match="no square"):
        tile_frames(replace(mesh, uv=mesh.uv + 0.5))


@pytest.mark.parametrize("name", surfaces.names())
def test_triangles_are_the_surface(name):
    """From above they are as high as the surface is; what faces up has normals that do."""
    surface = surfaces.load(name)
    made = parts(surface)
    height = np.concatenate([part.vertices[:, 2] for part in made])
    if isinstance(surface.shape, Tile):
        assert np.ptp(height) == pytest.approx(surface.shape.depth)
        assert height[: surface.shape.resolution].size and abs(height.mean()) < 1e-3
        return
    top = surface.shape.top - surface.shape.mean_height
    assert height.max() == pytest.approx(top, rel=0.01)
    bed = made[1]
    corners = bed.vertices[bed.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if bed.normals is not None:
        # Each triangle faces as its corners' normals do, and bodies close: areas sum to nothing.
        assert ((flat * bed.normals[bed.faces].mean(1)).sum(1) > 0).all()
        assert np.abs(flat.sum(0)).max() < 1e-9
    else:
        assert (flat[:, 2] > 0).all()
    assert (bed.tint is not None) == (name == "dyed-rods")


def test_a_body_of_triangles_has_the_spheres_area_and_nearly_its_volume():
    data = {"shape": "sphere", "per_side": 1, "size": 0.3, "arrangement": "grid"}
    surface = parse({"name": "one", "about": "x", "primitives": data, "micro": "mirror"})
    ball = parts(surface)[1]
    a, b, c = (ball.vertices - surface.shape.centre[0])[ball.faces].transpose(1, 0, 2)
    c, a, b = (v + [0, 0, surface.shape.mean_height] for v in (c, a, b))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(
        4 * np.pi * 0.3**2
    )
    assert (np.cross(a, b) * c).sum() / 6 == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=5e-3)


def plane(share: float) -> WalkedSurface:
    micro = MicroBSDF(MicroBSDF.of("lambertian", "micro").bsdf, (share, share, share))
    return WalkedSurface("plane", "x", Tile("plane", np.zeros((16, 16)), {}, smooth=False), micro,
                         micro)  # fmt: skip


def test_renders_of_a_plane_and_of_its_material_differ_by_their_albedo(monkeypatch):
    """Lambert's law learned a tenth too bright: of relative square 0.01, and nothing but noise."""
    from harness._methods.cosine import Cosine
    from harness.measures import patches

    monkeypatch.setattr(patches, "source_of", lambda _: plane(0.5))
    material, method = matt(0.55, 0.55, 0.55), Cosine()
    method.bind(material)
    job = SimpleNamespace(
        material=material,
        method=method,
        settings={"resolution": 24, "rounds": 2, "spp": 64, "truth_spp": 128},
        seed=1,
        scene=scenes.make({"name": "bent-quad", "texture_repeat": 4, "size": "small"}),
        generator=torch.Generator().manual_seed(0),
    )
    outcome = run("patches", [job])[0]
    found = {r.metric: r.value for r in outcome.records}
    assert outcome.images["truth"].shape == outcome.images["learned"].shape == (24, 24, 3)
    assert found["macro-error"] == pytest.approx(0.01, rel=0.35)
    times = found["truth-seconds-per-spp"] / found["seconds-per-spp"]
    expected = times * found["truth-noise"] / found["noise"]
    assert found["same-noise-time-ratio"] == pytest.approx(expected, rel=0.5)
    # 16^2 quads: single-precision vertices and texture coordinates, and indices.
    assert found["truth-size-bytes"] == 4 * (17 * 17 * 5 + 2 * 256 * 3)


def test_a_scene_without_sheets_is_refused():
    from harness.rendering.tiled import prepare_tiled

    with pytest.raises(Unsupported, match="other shapes than sheets"):
        prepare_tiled(scenes.make("uniform-sphere"), plane(0.5), 16)
    glitter = {"type": "principled", "roughness": 0.3}
    primitives = {"shape": "sphere", "per_side": 1, "size": 0.3, "arrangement": "grid"}
    micro = {"bsdf": glitter, "reflectance": "#808080"}
    surface = parse({"name": "m", "about": "x", "primitives": primitives, "micro": micro})
    with pytest.raises(Unsupported, match="the colour of a 'principled'"):
        prepare_tiled(scenes.make("quad"), surface, 16)


def test_noise_is_no_difference_at_large():
    """Over many draws: unbiased for equal images, and for a known difference."""
    random = np.random.default_rng(1)
    true = 1 + random.random((12, 12))
    variance = 0.2 * true
    errors = []
    for _ in range(400):
        images = [true * s + np.sqrt(variance) * random.standard_normal((12, 12)) for s in (1, 1.2)]
        mask = np.ones((12, 12), bool)
        known, own = (Blocks.of(image, variance, mask, 4) for image in images)
        raw = Raw({"pixels": known.pixels, "blocks": known.packed(),
                   "learned_blocks": own.packed()})  # fmt: skip
        errors.append(records.macro_error(raw))
    assert np.mean(errors) == pytest.approx(0.04, abs=4 * np.std(errors) / 20)


class Kept:
    """Results of one trial, with some of its images."""

    methods, materials = [SimpleNamespace(label="highest")], ["beads"]

    def __init__(self, *names: str):
        self.images = {name: np.full((4, 4, 3), 0.5, np.float32) for name in names}

    def scenes(self, _measure):
        return ["quad"]

    def trials(self, _measure, *_where):
        return ["one"]

    def stored(self, _trial):
        return SimpleNamespace(images=self.images)

    def number(self, *_where):
        return "none"


def test_a_copy_without_images_has_no_figure_and_says_so(tmp_path):
    from harness.report.figures.canvas import Canvas
    from harness.report.figures.patches import patches

    for names in ((), ("truth",)):
        assert "images" in patches(Kept(*names), Canvas(tmp_path))
    assert len(patches(Kept("truth", "learned"), Canvas(tmp_path))) == 1
