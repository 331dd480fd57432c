"""Path-traced queries of microgeometry: flat planes, energy, reciprocity, footprints, seeds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials.registry import make
from harness.microgeometry import descriptions
from harness.microgeometry.estimate import reflectance
from harness.microgeometry.queries import _inside, draw, energy, integral, stratified, truth
from harness.microgeometry.surface import Surface
from harness.microgeometry.walks import surfaces
from harness.textures.noise import fbm

PAINT = {"type": "principled", "base_color": [0.5, 0.2, 0.1], "roughness": 0.4}


def rgb(node: dict) -> dict:
    """``node`` with its colours as Mitsuba has them in a dictionary."""
    return {k: {"type": "rgb", "value": v} if isinstance(v, list) else v for k, v in node.items()}


def flat(bsdf: dict = PAINT, **more) -> Surface:
    return Surface("flat", np.zeros((16, 16)), rgb(bsdf), **more)


def white(depth: float = 0.03, smooth: bool = False) -> Surface:
    """Lossless Lambertian relief of flat triangles."""
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    return Surface("white", depth * fbm(64, (3, 3), seed=5, octaves=3), diffuse, smooth=smooth)


def rows(n: int, seed: int) -> tuple[torch.Tensor, ...]:
    random = torch.rand(n, 6, generator=torch.Generator().manual_seed(seed))
    return random[:, :2], square_to_disk(random[:, 2:4]), square_to_disk(random[:, 4:])


def test_a_flat_plane_gives_its_brdf_back():
    """Whatever place and footprint, over all directions, for light from one direction."""
    u, wi, wo = rows(20_000, 1)
    kernel = torch.linspace(0, 2, len(u))
    f = truth(flat(), u, kernel, wi, wo, samples=1, seed=0, light=0.0)
    brdf = make({"name": "paint", "type": "mitsuba", "bsdf": PAINT}).eval(wi, wo)
    error = ((f - brdf).abs() / brdf).amax(1)
    assert torch.quantile(error, 0.99) < 1e-5


def test_smoothed_light_blurs_the_brdf_by_its_width():
    """The mean is the BRDF under the Gaussian of directions, by independent sampling of it."""
    wi, wo = torch.tensor([[-0.3, 0.1]]), torch.tensor([[0.25, -0.05]])
    sigma, n = 0.1, 200_000
    one = [x.expand(64, -1).contiguous() for x in (wi, wo)]
    f = truth(flat(), torch.zeros(64, 2), torch.zeros(64), *one, 2048, seed=3, light=sigma)
    z = (1 - wo.square().sum()).sqrt()
    normal = torch.cat([wo[0], z[None]])
    a = torch.nn.functional.normalize(torch.linalg.cross(normal, torch.tensor([0.0, 1, 0])), dim=0)
    b = torch.linalg.cross(normal, a)
    offset = sigma * torch.randn(n, 2, generator=torch.Generator().manual_seed(1))
    moved = torch.nn.functional.normalize(normal + offset[:, :1] * a + offset[:, 1:] * b, dim=1)
    paint = make({"name": "paint", "type": "mitsuba", "bsdf": PAINT})
    expected = paint.eval(wi.expand(n, 2).contiguous(), moved[:, :2].contiguous())
    sharp = paint.eval(wi, wo)[0]
    spread = (f.var(0) / len(f) + expected.var(0) / n).sqrt()
    assert ((f.mean(0) - expected.mean(0)).abs() < 4 * spread).all()
    assert ((f.mean(0) - sharp).abs() > 20 * spread).all()


def test_lossless_relief_reflects_all_light():
    """Over places and all light, f has the mean 1/pi for each wi; less for fewer bounces."""
    surface, n = white(), 40_000
    assert surface.slope > 0.3
    for wi in ((0.0, 0.0), (0.75, -0.3), (-0.2, 0.97)):
        u, _, wo = rows(n, 2)
        all_wi = torch.tensor([wi]).expand(n, 2).contiguous()
        f = [truth(surface, u, torch.zeros(n), all_wi, wo, 1, 7, depth)[:, 0] for depth in (60, 1)]
        energy, spread = np.pi * f[0].mean(), np.pi * f[0].std() / n**0.5
        assert abs(energy - 1) < 4 * spread
        assert np.pi * f[1].mean() < 1 - 6 * spread


def test_energy_is_the_integral_of_reflectance():
    """Paths that choose no light against queries at light directions, for a glossy relief."""
    height = 0.02 * fbm(64, (3, 3), seed=5, octaves=2)
    surface = Surface("glossy", height, rgb({**PAINT, "roughness": 0.25}))
    n, side = 24, 64
    u, wi, _ = rows(n, 3)
    kernel = torch.full((n,), 0.02)
    each = [x.repeat_interleave(side * side, 0) for x in (u, kernel, wi)]
    ours, theirs = [], []
    for seed in range(16):  # one draw alone is skewed: few of its paths find a highlight
        ours.append(energy(surface, u, kernel, wi, samples=4096, seed=seed))
        f = truth(surface, *each, stratified(n, side, seed).view(-1, 2), 1, seed + 100)
        theirs.append(integral(f.view(n, -1, 3)))
    (found, error), (expected, spread) = (
        (torch.stack(x).mean(0), torch.stack(e).square().sum(0).sqrt() / len(x))
        for x, e in (zip(*pairs, strict=True) for pairs in (ours, theirs))
    )
    z = (found - expected) / torch.hypot(error, spread)
    assert z.abs().max() < 4.5 and abs(z.mean()) < 1
    assert (error < 0.05 * found).all()


@pytest.mark.parametrize("depth", [1, 60])
def test_energy_of_a_lossless_relief(depth):
    """All of it leaves after enough bounces, and what one bounce loses is the same both ways."""
    surface, n = white(), 64
    u, wi, _ = rows(n, 6)
    found, error = energy(surface, u, torch.zeros(n), wi, 1024, 1, depth)
    if depth == 1:
        assert found.mean() < 0.99
    else:
        assert ((found - 1).abs() <= 4.5 * error + 1e-4).all()


def test_the_error_of_an_energy_where_all_paths_agree_and_where_they_do_not():
    """A thousand times 0.7 has a variance of -6e-17, whose root is nan."""
    u, wi, _ = rows(256, 8)
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.7, 0.9]}}
    matt = Surface("matt", np.zeros((16, 16)), paint)
    found, error = energy(matt, u, torch.zeros(256), wi, 1000, 1)
    assert (found - torch.tensor([0.3, 0.7, 0.9])).abs().max() < 1e-5
    assert (error >= 0).all() and error.max() < 1e-6
    found, error = energy(white(), u, torch.zeros(256), wi, 333, 1, depth=1)
    assert (error > 0).float().mean() > 0.3


def test_an_integral_over_strata_and_its_error():
    """Errors are those of noise, and an upper bound, far below 1 / sqrt(n), where f is smooth."""
    n, side = 400, 8
    wo = stratified(n, side, seed=0)
    assert (wo.square().sum(-1) < 1).all()
    noise = torch.rand(n, side * side, 1, generator=torch.Generator().manual_seed(1))
    for f, mean, least in ((0.5 + noise, 1.0, 0.9), (1 + wo[..., :1], 1.0, 0.2)):
        found, error = integral(f)
        z = (found - np.pi * mean) / error
        assert least < z.std() < 1.1 and abs(z.mean()) < 4 * z.std() / n**0.5
    # Independent directions: the deviation of x on the disk is 1/2.
    assert error.mean() < 0.5 * np.pi * 0.5 / side


def test_interpolated_normals_lose_less_than_a_percent():
    """They are no geometry, so energy is not kept exactly; nor is any made."""
    n = 40_000
    u, _, wo = rows(n, 2)
    wi = torch.tensor([[0.75, -0.3]]).expand(n, 2).contiguous()
    f = truth(white(smooth=True), u, torch.zeros(n), wi, wo, 1, 7, depth=60)[:, 0]
    energy, spread = np.pi * f.mean(), np.pi * f.std() / n**0.5
    assert 0.99 - 4 * spread < energy < 1 + 4 * spread


def test_mean_over_the_tile_is_reciprocal():
    """Camera and light change places; at one place they do not (occlusion)."""
    surface, n = white(0.05), 60_000
    u, _, _ = rows(n, 4)
    a, b = (torch.tensor([w]).expand(n, 2).contiguous() for w in ((0.6, 0.2), (-0.5, 0.7)))
    there = truth(surface, u, torch.zeros(n), a, b, 1, 1, depth=8, light=0.0)[:, 0]
    back = truth(surface, u, torch.zeros(n), b, a, 1, 2, depth=8, light=0.0)[:, 0]
    spread = ((there.var() + back.var()) / n) ** 0.5
    assert abs(there.mean() - back.mean()) < 4 * spread
    assert (there - back).abs().mean() > 20 * spread


def test_the_tile_repeats():
    """A place some tiles away is the same place, at grazing angles too."""
    surface = white()
    u, wi, wo = rows(2000, 5)
    wi = wi / wi.norm(dim=1, keepdim=True) * 0.995
    shift = torch.tensor([3.0, -5.0])
    f = [truth(surface, x, torch.zeros(2000), wi, wo, 1, 9) for x in (u, u + shift)]
    # Rounding of the place moves a path over an edge once in a while.
    assert ((f[0] - f[1]).abs() > 1e-3 * (1 + f[0].abs())).any(1).float().mean() < 0.02


def test_a_large_footprint_is_the_mean_of_small_ones():
    """A footprint of sigma against Gaussian-weighted places of footprint zero."""
    diffuse = {"type": "bitmap", "array": np.float32(np.eye(16)[..., None]), "raw": True}
    striped = Surface(
        "striped", 0.02 * fbm(16, (2, 2), seed=1), {"type": "diffuse", "reflectance": diffuse}
    )
    n, sigma = 40_000, 0.07
    centre = torch.tensor([[0.3, 0.35]])
    wi, wo = (torch.tensor([w]).expand(n, 2).contiguous() for w in ((0.4, 0.3), (-0.5, 0.2)))
    offset = sigma * torch.randn(n, 2, generator=torch.Generator().manual_seed(3))
    small = truth(striped, centre + offset, torch.zeros(n), wi, wo, 1, 1)[:, 0]
    large = truth(striped, centre.expand(n, 2), torch.full((n,), sigma), wi, wo, 1, 2)[:, 0]
    sharp = truth(striped, centre.expand(n, 2), torch.zeros(n), wi, wo, 1, 2)[:, 0]
    spread = ((small.var() + large.var()) / n) ** 0.5
    assert abs(small.mean() - large.mean()) < 4 * spread
    assert abs(sharp.mean() - large.mean()) > 10 * spread


def test_parallax_follows_the_height():
    """On a raised plateau the camera sees a place that is shifted by height times tangent."""
    ramp = np.tile((np.arange(64) + 0.5) / 64, (64, 1))
    texture = {"type": "bitmap", "array": np.float32(ramp[..., None]), "raw": True}
    height = np.zeros((64, 64))
    height[:16] = -0.06  # a trench, so that the rest lies above the mean
    surface = Surface("plateau", height, {"type": "diffuse", "reflectance": texture})
    top = float(surface.height.max())
    u = torch.tensor([[0.4, 0.6]])
    f = truth(surface, u, torch.zeros(1), torch.tensor([[0.6, 0.0]]), torch.zeros(1, 2), 1, 0, 1)
    assert top > 0.01
    assert float(f[0, 0]) * np.pi == pytest.approx(0.4 + top * 0.6 / 0.8, abs=2e-3)


def test_shadows_fall_across_a_groove_and_not_along_it():
    """At its bottom, for low light, however many tiles away the ray leaves."""
    v = (np.arange(64) + 0.5) / 64
    grooves = np.tile(0.1 * np.cos(4 * np.pi * v)[:, None], (1, 64))  # the bottom is at v = 1/4
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    surface = Surface("grooves", grooves, grey)
    n = 5
    u = torch.tensor([[0.3, 0.25]]).expand(n, 2).contiguous()
    low = 0.999
    wo = torch.tensor([[low, 0], [-low, 0], [0, low], [0, -low], [0.99999995, 0]])
    f = truth(surface, u, torch.zeros(n), torch.zeros(n, 2), wo, 1, 0, depth=1, light=0.0)[:, 0]
    assert np.pi * f[:2] == pytest.approx(0.5, rel=1e-2)
    assert (f[2:4] == 0).all()
    assert torch.isfinite(f[4])  # a ray that could go on for ever


def test_anisotropy_turns_with_the_angle():
    """A frame turned by a right angle swaps the two roughnesses."""

    def metal(u: float, v: float) -> dict:
        return {"type": "roughconductor", "material": "none", "alpha_u": u, "alpha_v": v}

    u, wi, wo = rows(500, 8)
    turned = flat(metal(0.1, 0.4), angle=np.full((16, 16), np.pi / 2))
    f = truth(turned, u, torch.zeros(500), wi, wo, 1, 0, light=0.0)
    expected = truth(flat(metal(0.4, 0.1)), u, torch.zeros(500), wi, wo, 1, 0, light=0.0)
    torch.testing.assert_close(f, expected, rtol=1e-3, atol=1e-5)


def test_micro_normals_tilt_the_lobe():
    """Light across a tilted normal: Lambert's cosine is taken there."""
    tilt = np.array([0.3, 0.0, np.sqrt(1 - 0.09)])
    surface = flat(
        {"type": "diffuse", "reflectance": [0.5, 0.5, 0.5]}, micro=np.tile(tilt, (16, 16, 1))
    )
    wo = torch.tensor([[0.5, 0.0], [-0.5, 0.3]])
    f = truth(surface, torch.zeros(2, 2), torch.zeros(2), torch.zeros(2, 2), wo, 1, 0, light=0.0)
    z = (1 - wo.square().sum(1)).sqrt()
    expected = 0.5 / np.pi * (wo[:, 0] * tilt[0] + z * tilt[2]) / z
    torch.testing.assert_close(f[:, 0], expected.float(), rtol=1e-5, atol=0)


def test_answers_depend_on_row_and_seed_alone():
    """Not on the batches nor on what follows; another seed gives others."""
    surface = white()
    u, wi, wo = rows(300, 6)
    kernel = torch.full((300,), 0.01)
    whole = truth(surface, u, kernel, wi, wo, 5, seed=2**40 + 1)
    prefix = truth(surface, u[:70], kernel[:70], wi[:70], wo[:70], 5, seed=2**40 + 1)
    assert torch.equal(whole[:70], prefix)
    for lanes in (3, 64):  # fewer than the samples of one row, and a few rows
        small = reflectance(surface.tracer("cpu"), u, kernel, wi, wo, 5, 2**40 + 1, lanes=lanes)
        torch.testing.assert_close(small, whole, rtol=1e-5, atol=1e-6)
    assert not torch.equal(whole, truth(surface, u, kernel, wi, wo, 5, seed=1))


@pytest.mark.slow
@pytest.mark.parametrize("name", surfaces.reliefs())
def test_the_twelve_reflect_no_more_than_they_get(name):
    """Finite, not negative, and in the mean over places below one for light from all around."""
    surface, n = descriptions.load(name, resolution=128), 100_000
    u, _, wo = rows(n, 3)
    for wi in ((0.0, 0.0), (0.6, 0.5)):
        here = torch.tensor([wi]).expand(n, 2).contiguous()
        f = truth(surface, u, torch.zeros(n), here, wo, 1, 1, depth=8)
        assert torch.isfinite(f).all() and (f >= 0).all()
        assert (np.pi * f.mean(0) < 1).all() and (np.pi * f.mean(0) > 0.01).all()


def test_draws_are_seeded_and_cover_their_ranges():
    """Places over the tile, directions over the disk, footprints log-uniform."""
    q, again = (draw(flat(), 4000, seed=3, kernel=(1e-3, 1e-1), samples=1) for _ in range(2))
    assert all(torch.equal(x, y) for x, y in zip(q, again, strict=True))
    level = torch.log10(q.kernel)
    for values, low, high in (
        (q.u[:, 0], 0, 1),
        (q.wi.square().sum(1), 0, 1),
        (q.wo.square().sum(1), 0, 1),
        (level, -3, -1),
    ):
        place = (values - low) / (high - low)
        assert place.min() >= 0 and place.max() <= 1
        assert abs(place.mean() - 0.5) < 4 / (12 * 4000) ** 0.5
    assert (draw(flat(), 3, seed=0).kernel == 0.5 / 16).all()
    assert len(draw(flat(), 0, seed=0).f) == 0


def rim(past):
    """Directions [10001, 2] around the rim, ``past`` it."""
    angle = torch.linspace(0, 2 * torch.pi, 10001, dtype=torch.float64)
    return ((1 + past) * torch.stack([angle.cos(), angle.sin()], 1)).float()


@pytest.mark.parametrize("past", [0.0, 2**-23])
def test_directions_that_rounding_put_on_the_rim_are_brought_inside(past):
    found = _inside(rim(past))
    assert (found.square().sum(1) < 1).all()
    assert (found.double().norm(dim=1) > 1 - 2**-20).all()
    assert torch.equal(_inside(found), found)


@pytest.mark.parametrize("past", [1e-6, 1e-4, 1.0])
def test_directions_past_the_rim_by_more_are_refused(past):
    """They are no rounding: something is wrong with them, and nothing hides it."""
    wi = _inside(rim(past))
    zero = torch.zeros_like(wi)
    with pytest.raises(InputError, match="wi: expected directions inside the unit disk"):
        truth(flat(), zero, zero[:, 0], wi, zero, samples=1, seed=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wi": torch.tensor([[0.8, 0.6]])}, "wi: expected directions inside the unit disk"),
        ({"wo": torch.zeros(1, 3)}, r"wo: expected shape \[1, 2\], got \[1, 3\]"),
        ({"kernel": torch.tensor([-1.0])}, "kernel: expected footprints of at least 0"),
        ({"u": torch.tensor([[torch.nan, 0]])}, "u: expected finite numbers"),
        ({"samples": 0}, "expected at least 1 sample"),
        ({"light": -0.1}, "light: expected a deviation of at least 0"),
    ],
)
def test_impossible_queries_are_refused(change, message):
    zero = torch.zeros(1, 2)
    given = {"u": zero, "kernel": torch.zeros(1), "wi": zero, "wo": zero, "samples": 1, "seed": 0}
    with pytest.raises(InputError, match=message):
        truth(flat(), **{**given, **change})


def test_a_range_of_footprints_must_be_one():
    with pytest.raises(InputError, match="expected a footprint"):
        draw(flat(), 2, 0, kernel=(0.2, 0.1))
