"""Random walks through microgeometry: energy, distributions, and agreement with Mitsuba."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.geometry.shapes import grid_faces
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks import beckmann, surfaces
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.surface import WalkedSurface
from harness.mitsuba_runtime import variant
from tests.walks import rng, uniform_on_disk

mi = variant.use("cpu")

from harness.microgeometry.walks.heightfield import Heightfield  # noqa: E402
from harness.microgeometry.walks.kernel import walk  # noqa: E402
from harness.microgeometry.walks.micro import MicroBSDF  # noqa: E402

N = 1 << 17


def bed(shape: str, micro, size=0.4, **more) -> WalkedSurface:
    primitives = {"shape": shape, "per_side": 4, "size": size, "seed": 1, **more}
    return parse({"name": "mine", "about": "x", "primitives": primitives, "micro": micro})


def exits(surface, n: int, seed: int, wi=None):
    """Walks of light from all around (uniform on the disk), or from one direction."""
    generator = rng(seed)
    u, channel = torch.rand(n, 2, generator=generator), torch.randint(3, (n,), generator=generator)
    spread = square_to_disk(torch.rand(n, 2, generator=generator))
    at = spread if wi is None else torch.tensor(wi).expand(n, 2).contiguous()
    return surface.walk(u, at, channel, seed)


def field(alpha: float, micro: str, seed: int, resolution: int = 256) -> Heightfield:
    height = beckmann.heights(alpha, alpha, resolution, 4, seed)
    return Heightfield(Tile("field", height, {}, smooth=False), MicroBSDF.of(micro, "micro"), "cpu")


# --- energy ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "size", "more"),
    [
        ("sphere", 0.4, {}),
        ("ellipsoid", [0.5, 0.2, 0.3], {"direction": 20.0, "scatter": 10.0, "sunk": 0.4}),
        ("pyramid", [0.5, 0.6], {"arrangement": "grid"}),
    ],
)
def test_a_lossless_bed_returns_every_particle_and_keeps_diffuse_light_diffuse(shape, size, more):
    """Light of equal radiance all around leaves as it came: exits are uniform on the disk."""
    found = exits(bed(shape, "mirror", size, **more), N, 1)
    assert found.counts.left == found.counts.walks == N
    assert found.left.all() and found.counts.unfinished == found.counts.above_one == 0
    assert found.counts.interactions == int(found.bounces.sum())
    assert uniform_on_disk(found.wo).p_value > 1e-4
    # Seen from one side it is not.
    oblique = exits(bed(shape, "mirror", size, **more), N, 1, (0.6, 0.2))
    assert uniform_on_disk(oblique.wo).p_value < 1e-9


def test_matt_grains_lose_nothing_but_what_is_caught_in_crevices():
    found = exits(bed("sphere", "lambertian"), N, 2)
    assert found.counts.absorbed == 0 and found.counts.unfinished < 1e-4 * N
    assert uniform_on_disk(found.wo[found.left]).p_value > 1e-4


def test_a_lambertian_plane_gives_the_cosine_law():
    """In each channel with its own reflectance, from any side."""
    plane = Tile("plane", np.zeros((16, 16)), {}, smooth=False)
    micro = MicroBSDF(MicroBSDF.of("lambertian", "micro").bsdf, (0.2, 0.5, 0.9))
    geometry = Heightfield(plane, micro, "cpu")
    channel = torch.arange(3).repeat(N // 3)
    wi = torch.tensor([0.7, 0.3]).expand(len(channel), 2).contiguous()
    found = walk(geometry, torch.rand(len(channel), 2, generator=rng(1)), wi, channel, 5)
    assert uniform_on_disk(found.wo[found.left]).p_value > 1e-4
    assert (found.bounces == 1).all() and (found.wo[~found.left] == 0).all()
    for k, share in enumerate((0.2, 0.5, 0.9)):
        left = found.left[channel == k].double()
        deviation = math.sqrt(share * (1 - share) / len(left))
        assert abs(float(left.mean()) - share) < 4 * deviation


def test_walks_depend_on_the_row_and_the_seed_alone():
    surface = bed("sphere", {"bsdf": "rough-conductor", "reflectance": "#c08040"})
    u, wi = torch.rand(1000, 2, generator=rng(3)), square_to_disk(torch.rand(1000, 2))
    channel = torch.randint(3, (1000,), generator=rng(4))
    whole = surface.walk(u, wi, channel, 7)
    parts = walk(surface.geometry("cpu"), u, wi, channel, 7, lanes=300)
    assert torch.equal(whole.wo, parts.wo) and torch.equal(whole.left, parts.left)
    assert vars(whole.counts) == vars(parts.counts)
    other = surface.walk(u, wi, channel, 7 + (1 << 40))
    assert not torch.equal(whole.wo, other.wo)
    empty = surface.walk(u[:0], wi[:0], channel[:0], 7)
    assert empty.wo.shape == (0, 2) and empty.counts.walks == 0


def test_a_walk_that_does_not_end_is_counted():
    surface = bed("sphere", "mirror")
    u, wi = torch.rand(N, 2, generator=rng(5)), square_to_disk(torch.rand(N, 2, generator=rng(6)))
    bounded = walk(surface.geometry("cpu"), u, wi, torch.zeros(N, dtype=torch.long), 1, bound=2)
    assert bounded.counts.unfinished > 0 and bounded.counts.absorbed == 0
    assert bounded.counts.left == int(bounded.left.sum()) and bounded.bounces.max() == 2


def test_weights_above_one_are_counted():
    """An albedo of 1.2: Russian roulette cannot keep it."""
    bright = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.6, 0.6]}}
    micro = MicroBSDF(bright, (2.0, 2.0, 2.0))
    plane = Tile("plane", np.zeros((16, 16)), {}, smooth=False)
    u = torch.rand(1000, 2)
    found = walk(Heightfield(plane, micro, "cpu"), u, 0 * u, torch.zeros(1000), 1)
    assert found.counts.above_one == 1000 and found.counts.left == 1000


def test_the_ground_and_the_primitives_have_their_own():
    """Black grains on a white ground: what leaves has met the ground alone."""
    data = {
        "name": "mine",
        "about": "x",
        "primitives": {"shape": "sphere", "per_side": 4, "size": 0.4, "seed": 1},
        "micro": {"bsdf": "mirror", "reflectance": "#010101"},
        "ground": "mirror",
    }
    found = exits(parse(data), N, 8, (0.0, 0.0))
    seen = 1 - 16 * math.pi * (0.4 / 4) ** 2
    assert found.counts.left / N == pytest.approx(seen, abs=0.006)


# --- beside Mitsuba --------------------------------------------------------------------


def single_bounces(alpha: float, wi: tuple[float, float], n: int, cells: int) -> np.ndarray:
    """Share [cells, cells] of particles that leave after one bounce off mirror facets."""
    total = np.zeros((cells, cells))
    fields = 4
    for seed in range(fields):
        geometry = field(alpha, "mirror", seed)
        u, at = torch.rand(n, 2, generator=rng(seed)), torch.tensor(wi).expand(n, 2).contiguous()
        found = walk(geometry, u, at, torch.zeros(n), seed)
        # A ray in millions slips through an edge of triangles, and is counted.
        assert found.counts.absorbed == 0 and found.counts.unfinished < 1e-4 * n
        once = found.wo[found.bounces == 1].numpy()
        total += np.histogram2d(*once.T, bins=cells, range=[[-1, 1]] * 2)[0]
    return total / (n * fields)


def rough_conductor(alpha: float, wi: tuple[float, float], cells: int) -> np.ndarray:
    """The same of Mitsuba's: f over the cells of the disk."""
    data = {"type": "roughconductor", "distribution": "beckmann", "alpha": alpha}
    bsdf = mi.load_dict({**data, "material": "none"})
    sub = 8 * cells
    at = (np.arange(sub) + 0.5) / sub * 2 - 1
    x, y = np.meshgrid(at, at, indexing="ij")
    inside = x**2 + y**2 < 1
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*wi, math.sqrt(1 - wi[0] ** 2 - wi[1] ** 2))
    z = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    wo = mi.Vector3f(*(np.ravel(v).astype(np.float32) for v in (x, y, z)))
    value = np.array(bsdf.eval(mi.BSDFContext(), si, wo))[0].reshape(sub, sub) / z
    value = np.where(inside, value, 0) * (2 / sub) ** 2
    return value.reshape(cells, 8, cells, 8).sum((1, 3))


@pytest.mark.parametrize(("alpha", "wi"), [(0.2, (0.0, 0.0)), (0.3, (0.5, 0.0))])
def test_a_facet_field_scatters_once_as_a_rough_conductor(alpha, wi):
    """Smith's masking supposes independent heights, which a field nearly has: 1 % of the energy."""
    cells = 16
    found, expected = single_bounces(alpha, wi, 1 << 15, cells), rough_conductor(alpha, wi, cells)
    assert found.sum() == pytest.approx(expected.sum(), abs=0.01)
    assert np.abs(found - expected).sum() < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("wi", [(0.0, 0.0), (0.6, 0.3), (-0.2, 0.85)])
def test_a_bed_of_mirror_spheres_reflects_as_its_mesh_does_in_mitsuba(wi):
    """Directional albedo by Mitsuba's path tracer under constant light, within 0.5 %."""
    share = 0.6
    surface = bed("sphere", "mirror")
    geometry = surface.geometry("cpu")
    geometry.shares = [mi.Color3f(share)]
    n = 1 << 22
    found = exits(surface, n, 11, wi)
    albedo = found.counts.left / n
    expected, error = path_traced(surface, share, wi, 1 << 20)
    noise = math.hypot(math.sqrt(albedo * (1 - albedo) / n), error)
    assert noise < 0.001 * albedo
    assert albedo == pytest.approx(expected, rel=0.005)


def path_traced(surface: WalkedSurface, share: float, wi, n: int) -> tuple[float, float]:
    """Radiance towards ``wi`` of nine by nine tiles as triangles, seen through the middle one."""
    rows, tiles = 24, 9
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1), indexing="ij"
    )
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    # The mean radius of a body of triangles is that of the sphere.
    unit = unit.reshape(-1, 3) * (1 + (np.pi / rows) ** 2 / 6)
    faces, count = grid_faces(rows, 2 * rows), len(unit)
    shift = np.arange(tiles) - tiles // 2
    centres = [c + [x, y, 0] for c in surface.shape.centre for x in shift for y in shift]
    vertices = np.concatenate([c + unit * surface.shape.axes[0, 0, 0] for c in centres])
    triangles = np.concatenate([faces + i * count for i in range(len(centres))])
    mesh = mi.Mesh("grains", vertex_count=len(vertices), face_count=len(triangles))
    mesh.set_bsdf(mi.load_dict({"type": "twosided", "b": mirror(share)}))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    parameters["faces"] = np.ravel(triangles).astype(np.uint32)
    parameters.update()
    ground = mi.ScalarTransform4f().scale(tiles)
    scene = mi.load_dict(
        {
            "type": "scene",
            "grains": mesh,
            "ground": {"type": "rectangle", "to_world": ground, "bsdf": mirror(share)},
            "light": {"type": "constant", "radiance": 1.0},
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": 64, "rr_depth": 64})
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(3, n)
    d = mi.Vector3f(*wi, math.sqrt(1 - wi[0] ** 2 - wi[1] ** 2))
    through = mi.Point3f(*(sampler.next_2d()), surface.shape.mean_height)
    ray = mi.RayDifferential3f(mi.Ray3f(through + d * (0.3 / d.z), -d))
    radiance, _, _ = integrator.sample(scene, sampler, ray)
    value = np.array(radiance)[0].astype(float)
    return value.mean(), value.std() / math.sqrt(n)


def mirror(share: float) -> dict:
    colour = {"type": "rgb", "value": [share] * 3}
    return {"type": "conductor", "material": "none", "specular_reflectance": colour}


def test_every_described_surface_lets_particles_leave():
    for name in surfaces.names():
        found = exits(surfaces.load(name), 1 << 13, 1)
        counts = found.counts
        assert 0.05 < counts.left / counts.walks < 0.95, name
        assert counts.unfinished == counts.above_one == 0, name


def test_a_relief_walks_with_its_own_bsdf():
    surface = surfaces.load("leather", resolution=64)
    assert surface.name == "leather" and surface.about
    found = exits(surface, 1 << 13, 1)
    assert 0.1 < found.counts.left / found.counts.walks < 0.4
