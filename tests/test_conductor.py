"""The multiple-bounce conductor: energy, reciprocity, its limits, and its two estimates."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness._methods.native import Native
from harness.core.protocol.disk import inside_disk, square_to_disk, to_direction
from harness.materials import registry
from tests.disk import compare
from tests.walks import (
    albedo,
    binned,
    diffuse_exits,
    evaluated,
    exits,
    family,
    rng,
    uniform_on_disk,
    z_scores,
)

WHITE = {"r0_r": 1.0, "r0_g": 1.0, "r0_b": 1.0}
COPPER = {"r0_r": 0.95, "r0_g": 0.6, "r0_b": 0.3}
ROUGH = [(1.0, 1.0), (0.6, 0.2), (0.1, 0.1)]
rough = pytest.mark.parametrize("alpha", ROUGH, ids=str)
DIRECTIONS = [(0.0, 0.0), (0.6, 0.3), (-0.2, 0.96)]


def conductor(alpha: tuple[float, float], walks: int | None = None, **colour: float):
    return family("ggx-conductor", walks, alpha_x=alpha[0], alpha_y=alpha[1], **colour)


# --- energy ----------------------------------------------------------------------------


@rough
def test_furnace(alpha):
    """A lossless surface: every walk leaves, and f found by connections integrates to one."""
    material = conductor(alpha, **WHITE)
    for wi in DIRECTIONS:
        row = torch.tensor(wi)
        wo, weight = exits(material, row, 1 << 14, 0)
        assert (weight == 1).all() and inside_disk(wo).all()
        mean, error = albedo(material, row, 1 << 15, 1)
        assert ((mean - 1).abs() <= 4 * error).all() and (error < 0.02).all()


@rough
def test_diffuse_light_stays_diffuse(alpha):
    """Cosine-weighted light leaves a lossless surface uniform on the disk; one bounce does not."""
    material = conductor(alpha, **WHITE)
    wo, _ = diffuse_exits(material, 1 << 18, 2)
    assert uniform_on_disk(wo[inside_disk(wo)]).p_value > 1e-4
    if alpha != (0.1, 0.1):  # of which all but one per cent leaves after one bounce
        wo, weight = diffuse_exits(material.with_effects(frozenset()), 1 << 18, 2)
        assert torch.equal(inside_disk(wo), weight[:, 0] > 0)
        assert uniform_on_disk(wo[inside_disk(wo)]).p_value < 1e-12


@settings(max_examples=25, deadline=None)
@given(
    ax=st.floats(1e-3, 1.5),
    ay=st.floats(1e-3, 1.5),
    radius=st.floats(0, 1),
    turn=st.floats(0, 2 * math.pi),
)
def test_walks_keep_energy(ax, ay, radius, turn):
    """Of any roughness, from any direction, the rim included."""
    wi = [radius * math.cos(turn), radius * math.sin(turn)]
    row = torch.tensor([ax, ay, 1.0, 0.5, 0.0, *wi])
    wo, weight = exits(registry.make("ggx-conductor"), row, 512, 3)
    assert wo.isfinite().all() and weight.isfinite().all()
    assert (weight[:, 0] == 1).all() and inside_disk(wo).all()
    assert ((weight >= 0) & (weight <= 1)).all()


# --- the two estimates of f ------------------------------------------------------------


@rough
def test_walks_follow_eval(alpha):
    """What walks bring into each part of the disk is what f has there, in each colour."""
    material = conductor(alpha, **COPPER)
    row = torch.tensor([0.5, -0.4])
    z = z_scores(binned(material, row, 1 << 19, 4), evaluated(material, row, 512, 5))
    assert z.square().mean() < 1.3 and z.abs().max() < 5.5


def test_reciprocity():
    """f2+ from wi and from wo are two different sums of walks, and agree."""
    material = registry.make(
        {"name": "m", "type": "family", "family": "ggx-conductor", "walks": 512}
    )
    n = 256
    condition = material.conditions(n, rng(6))
    condition[:, :2] = 0.2 + 0.8 * torch.rand(n, 2, generator=rng(7))
    wo = square_to_disk(0.02 + 0.96 * torch.rand(n, 2, generator=rng(8)))
    swapped = torch.cat([condition[:, :-2], wo], 1)
    single = material.with_effects(frozenset())
    torch.testing.assert_close(single.eval(condition, wo), single.eval(swapped, condition[:, -2:]))
    there = material.eval(condition, wo), material.noise(condition, wo)
    back = material.eval(swapped, condition[:, -2:]), material.noise(swapped, condition[:, -2:])
    z = z_scores(there, back)
    # Squares of t of some thirty degrees of freedom.
    assert z.square().mean() < 1.4 and z.mean().abs() < 4 / math.sqrt(n)
    assert ((there[0] - single.eval(condition, wo)) / there[1] > 10).float().mean() > 0.5


def test_noise_falls_with_walks():
    """As the square root of their number."""
    few, many = (conductor((0.6, 0.6), walks, **COPPER) for walks in (4, 64))
    wi, wo = (0.9 * square_to_disk(torch.rand(512, 2, generator=rng(s))) for s in (9, 10))
    ratio = few.noise(wi, wo).square().mean() / many.noise(wi, wo).square().mean()
    assert ratio.item() == pytest.approx(16, rel=0.3)
    assert few.identity() != many.identity()


# --- limits ----------------------------------------------------------------------------


def smith(w: Tensor, alpha: tuple[float, float]) -> Tensor:
    """Lambda [N] by its textbook form, in double precision."""
    x, y, z = w.unbind(1)
    tan_squared = ((alpha[0] * x) ** 2 + (alpha[1] * y) ** 2) / z**2
    return ((1 + tan_squared).sqrt() - 1) / 2


@rough
def test_one_bounce_is_mitsubas_conductor(alpha):
    """Apart from masking, which is correlated here and a product there."""
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    bsdf = {
        "type": "roughconductor",
        "distribution": "ggx",
        "material": "none",
        "alpha_u": alpha[0],
        "alpha_v": alpha[1],
    }
    theirs, ours = MitsubaMaterial("rough", bsdf, {}), conductor(alpha, **WHITE)
    n = 4096
    wi, wo = (0.98 * square_to_disk(torch.rand(n, 2, generator=rng(s))) for s in (11, 12))
    found = ours.with_effects(frozenset()).eval(wi, wo)
    a, b = (smith(to_direction(w.double()), alpha) for w in (wi, wo))
    masking = (1 + a + b) / ((1 + a) * (1 + b))
    expected = theirs.eval(wi, wo)
    torch.testing.assert_close(found * masking[:, None].float(), expected, rtol=2e-3, atol=1e-7)


def test_smooth_surfaces_bounce_once():
    """The share of further bounces vanishes with the roughness."""
    row = torch.tensor([0.5, 0.3])
    share = []
    for alpha in (0.4, 0.1, 0.025):
        _, weight = exits(
            conductor((alpha, alpha), **WHITE).with_effects(frozenset()), row, 1 << 16, 13
        )
        share.append(1 - weight[:, 0].mean().item())
    assert share[0] > 5 * share[1] > 25 * share[2] > 0


def test_fresnel():
    """Of one bounce: Schlick's by the angle at the half vector; further bounces darken more."""
    n = 512
    wi, wo = (square_to_disk(torch.rand(n, 2, generator=rng(s))) for s in (14, 15))
    copper, white = (conductor((0.7, 0.4), **c) for c in (COPPER, WHITE))
    once = [m.with_effects(frozenset()).eval(wi, wo) for m in (copper, white)]
    a, b = to_direction(wi.double()), to_direction(wo.double())
    cos = (a * torch.nn.functional.normalize(a + b, dim=1)).sum(1, keepdim=True)
    r0 = torch.tensor(list(COPPER.values()), dtype=torch.float64)
    expected = (r0 + (1 - r0) * (1 - cos) ** 5).float()
    torch.testing.assert_close(once[0] / once[1], expected, rtol=1e-4, atol=1e-5)
    more = (copper.eval(wi, wo) - once[0]).mean(0) / (white.eval(wi, wo) - once[1]).mean(0)
    assert (more < (once[0] / once[1]).mean(0)).all() and more[0] > more[1] > more[2] > 0


def test_mirror_symmetry_and_rotation():
    """A quarter turn of everything, and a reflection about an axis, change no albedo."""
    row = torch.tensor([0.6, 0.3])
    turned = torch.tensor([-0.3, 0.6])
    flipped = torch.tensor([-0.6, 0.3])
    a = albedo(conductor((0.6, 0.2), **COPPER), row, 1 << 14, 16)
    for alpha, wi in (((0.2, 0.6), turned), ((0.6, 0.2), flipped)):
        assert z_scores(a, albedo(conductor(alpha, **COPPER), wi, 1 << 14, 17)).abs().max() < 4.5


# --- effects and samplers --------------------------------------------------------------


def test_effects():
    """Without its effect the material is one bounce, by eval and by walk; nothing else changes."""
    material = conductor((0.8, 0.8), **COPPER)
    single = material.with_effects(frozenset())
    assert material.effects == single.effects == {"multiple-scattering"}
    assert single.identity()["without"] == ["multiple-scattering"]
    assert material.with_effects(material.effects) is material
    assert material.off == frozenset() and single.with_effects(frozenset()) is single
    assert single.with_effects(material.effects | {"media"}).identity() == material.identity()
    row = torch.tensor([0.5, -0.4])
    _, weight = exits(single, row, 1 << 16, 18)
    walked = weight.double().mean(0), weight.double().std(0) / 256
    assert z_scores(walked, albedo(single, row, 1 << 15, 19)).abs().max() < 4.5
    assert (albedo(single, row, 1 << 14, 20)[0] < 0.9 * albedo(material, row, 1 << 14, 20)[0]).all()


@rough
@pytest.mark.parametrize("wi", DIRECTIONS, ids=str)
def test_native_sampler_is_exact(alpha, wi):
    """Chi-square on the disk, and the integral of the density."""
    method = Native()
    method.bind(conductor(alpha, **WHITE))
    n = 1 << 16
    test, integral, valid = compare(method, torch.tensor(wi), n, rng(21))
    assert test.p_value > 1e-4
    assert abs(integral - valid) < 2e-3 + 5 * math.sqrt(valid * (1 - valid) / n)


@pytest.mark.parametrize("alpha", [1e-4, 1e-2, 1.0])
@pytest.mark.parametrize("cosine", [0.0, 1e-6, 1e-3, 1.0])
def test_extremes_are_finite(alpha, cosine):
    """Grazing and horizontal, near-specular: walks leave, f and pdf are numbers."""
    material = registry.make("ggx-conductor")
    row = torch.tensor([alpha, 1.0, 1.0, 0.5, 0.0, math.sqrt(1 - cosine**2), 0.0])
    wo, weight = exits(material, row, 4096, 22)
    assert (weight[:, 0] == 1).all() and inside_disk(wo).all()
    condition = row.expand(len(wo), -1).contiguous()
    assert material.eval(condition, wo).isfinite().all()
    method = Native()
    method.bind(material)
    density = method.pdf(condition, wo)
    assert density.isfinite().all() and (density > 0).all()


def test_nan_stays_in_its_row():
    """And its walk ends."""
    material = registry.make("ggx-conductor")
    condition = material.conditions(64, rng(23))
    u = torch.rand(64, 3, generator=rng(24))
    wo, weight = material.walk_sample(condition, u)
    f = material.eval(condition, u[:, :2] - 0.5)
    for column in range(condition.shape[1]):
        bad = condition.clone()
        bad[7, column] = math.nan
        other, dimmed = material.walk_sample(bad, u)
        keep = torch.arange(64) != 7
        assert torch.equal(other[keep], wo[keep]) and torch.equal(dimmed[keep], weight[keep])
        assert torch.equal(material.eval(bad, u[:, :2] - 0.5)[keep], f[keep])
