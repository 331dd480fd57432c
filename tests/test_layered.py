"""The layered family: energy, reciprocity, its limits, and its two estimates."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness._methods.native import Native
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import cos_theta, inside_disk, square_to_disk
from harness.materials import registry
from harness.materials.mitsuba_bsdf import MitsubaMaterial
from harness.mitsuba_runtime import variant
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

variant.use("cpu")

SMOOTH = 1e-3
"""A roughness at which the interface loses less than any of these tests sees."""
CLEAR = {"albedo_r": 1.0, "albedo_g": 1.0, "albedo_b": 1.0}
TEA = {"albedo_r": 0.95, "albedo_g": 0.7, "albedo_b": 0.2}
DIRECTIONS = [(0.0, 0.0), (0.6, 0.3), (-0.2, 0.96)]


def layered(walks: int | None = None, **fix: float):
    return family("layered", walks, **{"eta": 1.5, "alpha": 0.2, "sigma_t": 1.0, **TEA, **fix})


def mean(values: Tensor) -> tuple[Tensor, Tensor]:
    """Mean [3] of rows [N, 3] and its standard error."""
    values = values.double()
    return values.mean(0), values.std(0) / math.sqrt(len(values))


# --- energy ----------------------------------------------------------------------------


@pytest.mark.parametrize(("eta", "depth"), [(1.5, 0.0), (1.5, 1.0), (1.2, 5.0)])
def test_furnace(eta, depth):
    """Nothing absorbs and the interface is smooth: all light comes back, by walk and by eval."""
    material = layered(eta=eta, alpha=SMOOTH, sigma_t=depth, base=1.0, **CLEAR)
    for wi in DIRECTIONS:
        row = torch.tensor(wi)
        wo, weight = exits(material, row, 1 << 13, 0)
        assert torch.equal(inside_disk(wo), weight[:, 0] > 0)
        torch.testing.assert_close(weight.mean(0), torch.ones(3), rtol=0, atol=1e-3)
        total, error = albedo(material, row, 1 << 15, 1)
        assert ((total - 1).abs() <= 4 * error + 1e-3).all() and (error < 0.02).all()


def test_diffuse_light_stays_diffuse():
    """Cosine-weighted light leaves a lossless layer uniform on the disk, an absorbing one not."""
    depth = {"alpha": SMOOTH, "sigma_t": 1.5}
    wo, _ = diffuse_exits(layered(base=1.0, **depth, **CLEAR), 1 << 17, 2)
    assert uniform_on_disk(wo[inside_disk(wo)]).p_value > 1e-4
    wo, _ = diffuse_exits(layered(base=0.2, **depth), 1 << 17, 2)
    assert uniform_on_disk(wo[inside_disk(wo)]).p_value < 1e-12


@settings(max_examples=20, deadline=None)
@given(
    eta=st.floats(1, 2.5),
    alpha=st.floats(1e-3, 1.5),
    depth=st.floats(0, 5),
    radius=st.floats(0, 1),
    turn=st.floats(0, 2 * math.pi),
)
def test_no_energy_is_made(eta, alpha, depth, radius, turn):
    """At most all light leaves, whatever the layers: the interface only ever loses."""
    wi = [radius * math.cos(turn), radius * math.sin(turn)]
    material = layered(eta=eta, alpha=alpha, sigma_t=depth, base=1.0, **CLEAR)
    wo, weight = exits(material, torch.tensor(wi), 2048, 3)
    assert wo.isfinite().all() and (weight >= 0).all()
    assert torch.equal(inside_disk(wo), (weight > 0).any(1))
    total, error = mean(weight)
    assert (total <= 1 + 4 * error + 1e-4).all()


# --- the two estimates of f ------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.8, 0.2])
def test_walks_follow_eval(alpha):
    """What walks bring into each part of the disk is what f has there, in each colour."""
    material, row = layered(alpha=alpha), torch.tensor([0.5, -0.4])
    z = z_scores(binned(material, row, 1 << 18, 4), evaluated(material, row, 128, 5))
    assert z.square().mean() < 1.3 and z.abs().max() < 5.5


def test_reciprocity():
    """The two sides are treated differently, and f is the same."""
    n = 256
    material = family("layered", 256, base=0.9)
    condition = material.conditions(n, rng(6))
    wo = square_to_disk(torch.rand(n, 2, generator=rng(8)))
    swapped = torch.cat([condition[:, :-2], wo], 1)
    there = material.eval(condition, wo), material.noise(condition, wo)
    back = material.eval(swapped, condition[:, -2:]), material.noise(swapped, condition[:, -2:])
    z = z_scores(there, back)
    # Squares of t of some thirty degrees of freedom.
    assert z.square().mean() < 1.4 and z.mean().abs() < 4 / math.sqrt(n)
    assert (there[0] / there[1] > 5).float().mean() > 0.5


# --- limits ----------------------------------------------------------------------------


def test_smooth_without_medium_is_mitsubas_plastic():
    """All internal reflections in closed form: diffuse under a smooth interface."""
    base, n = 0.7, 512
    bsdf = {
        "type": "plastic",
        "int_ior": 1.5,
        "ext_ior": 1.0,
        "nonlinear": True,
        "diffuse_reflectance": {"type": "rgb", "value": [base] * 3},
    }
    ours = layered(256, alpha=SMOOTH, sigma_t=0.0, base=base)
    wi, wo = (0.98 * square_to_disk(torch.rand(n, 2, generator=rng(s))) for s in (9, 10))
    away = (wi + wo).norm(dim=1) > 0.1  # from the mirror direction
    wi, wo = wi[away], wo[away]
    plastic = mi.load_dict(bsdf)
    si = MitsubaMaterial("diffuse", {"type": "diffuse"}, {}).interaction(columns_of(wi))
    x, y = columns_of(wo)
    z = dr.sqrt(1 - x * x - y * y)
    expected = tensor_of(
        *(plastic.eval(mi.BSDFContext(), si, mi.Vector3f(x, y, z)) / z), rows=len(wi)
    )
    found, noise = ours.eval(wi, wo), ours.noise(wi, wo)
    z = ((found - expected) / noise)[:, 0]
    assert z.abs().max() < 6 and z.square().mean() < 1.6
    ratio, error = mean(found / expected)
    assert ((ratio - 1).abs() < 4 * error + 1e-3).all() and (error < 2e-3).all()


def chandrasekhar(albedo: float, mu: np.ndarray, nodes: int = 64) -> np.ndarray:
    """H(mu) of isotropic scattering, by iteration on Gauss points (Chandrasekhar 1960, ch. V)."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    h = np.ones(nodes)
    root = math.sqrt(1 - albedo)

    def again(at: np.ndarray) -> np.ndarray:
        return 1 / (root + albedo / 2 * (w * x * h / (at[:, None] + x)).sum(1))

    for _ in range(400):
        h = again(x)
    return again(mu)


def test_deep_medium_is_chandrasekhars():
    """Without an interface and without an end: f = a H H / (4 pi (mu + mu0))."""
    material = layered(64, eta=1.0, alpha=1e-4, sigma_t=50.0, base=0.0)
    n = 256
    wi, wo = (0.99 * square_to_disk(torch.rand(n, 2, generator=rng(s))) for s in (11, 12))
    found, noise = material.eval(wi, wo), material.noise(wi, wo)
    mu, mu0 = cos_theta(wo.double()).numpy(), cos_theta(wi.double()).numpy()
    for channel, a in enumerate(TEA.values()):
        h = chandrasekhar(a, mu) * chandrasekhar(a, mu0)
        expected = torch.from_numpy(a / (4 * math.pi) * h / (mu + mu0))
        ratio, error = mean((found[:, channel : channel + 1] / expected[:, None]).expand(-1, 3))
        assert (ratio - 1).abs()[0] < 4 * error[0] + 1e-3 and error[0] < 0.01
        z = (found[:, channel] - expected) / noise[:, channel]
        assert z.square().mean() < 1.6


def test_nothing_in_between_is_the_base():
    """Index one and no medium: Lambert, to the masking of the smooth interface."""
    material = layered(eta=1.0, alpha=1e-4, sigma_t=0.0, base=0.6)
    wi, wo = (0.98 * square_to_disk(torch.rand(256, 2, generator=rng(s))) for s in (13, 14))
    expected = torch.full((256, 3), 0.6 / math.pi)
    torch.testing.assert_close(material.eval(wi, wo), expected, rtol=1e-3, atol=0)


def test_reflection_is_mitsubas_rough_dielectric():
    """f of a black base: the interface's upper side alone, in closed form."""
    n = 2048
    wi, wo = (0.98 * square_to_disk(torch.rand(n, 2, generator=rng(s))) for s in (15, 16))
    glass = mi.load_dict(
        {
            "type": "roughdielectric",
            "distribution": "ggx",
            "alpha": 0.3,
            "int_ior": 1.5,
            "ext_ior": 1.0,
        }
    )
    si = MitsubaMaterial("diffuse", {"type": "diffuse"}, {}).interaction(columns_of(wi))
    x, y = columns_of(wo)
    z = dr.sqrt(1 - x * x - y * y)
    expected = tensor_of(*(glass.eval(mi.BSDFContext(), si, mi.Vector3f(x, y, z)) / z), rows=n)
    found = layered(alpha=0.3, sigma_t=0.0, base=0.0).eval(wi, wo)
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=1e-6)


def traced(alpha: float, base: float, wi: tuple[float, float], n: int) -> tuple[Tensor, Tensor]:
    """Light between Mitsuba's rough dielectric and a diffuse base: cosines and weights of exits."""
    glass = mi.load_dict(
        {
            "type": "roughdielectric",
            "distribution": "ggx",
            "alpha": alpha,
            "int_ior": 1.5,
            "ext_ior": 1.0,
        }
    )
    context = mi.BSDFContext()
    context.mode = mi.TransportMode.Importance  # of flux: no factor eta^2
    random = np.random.default_rng(17)
    direction = np.tile([*wi, math.sqrt(1 - wi[0] ** 2 - wi[1] ** 2)], (n, 1))
    weight, cos = np.ones(n), np.zeros(n)
    alive = np.arange(n)
    for _ in range(200):
        if not len(alive):
            break
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(*(mi.Float(c.astype("f")) for c in direction[alive].T))
        u = random.random((3, len(alive))).astype("f")
        bs, value = glass.sample(context, si, mi.Float(u[0]), mi.Point2f(u[1], u[2]))
        value, out = np.asarray(value[0]), np.asarray(bs.wo).T
        weight[alive] *= value
        up = (out[:, 2] > 0) & (value > 0)
        cos[alive[up]] = out[up, 2]
        down = (out[:, 2] < 0) & (value > 0)
        weight[alive[value == 0]] = 0
        alive = alive[down]
        weight[alive] *= base
        z = np.sqrt(random.random(len(alive)))
        turn = 2 * math.pi * random.random(len(alive))
        # To the interface again, from below: Mitsuba's wi points back down to where it came from.
        r = np.sqrt(1 - z * z)
        direction[alive] = np.stack([r * np.cos(turn), r * np.sin(turn), -z], 1)
    return torch.from_numpy(cos), torch.from_numpy(weight)


@pytest.mark.parametrize("alpha", [0.6, 0.1])
def test_rough_without_medium_is_a_path_through_mitsubas(alpha):
    """Energy by the cosine at which it leaves, two independent tracings."""
    wi, base, n = (0.5, -0.4), 0.8, 1 << 17
    material = layered(alpha=alpha, sigma_t=0.0, base=base)
    wo, ours = exits(material, torch.tensor(wi), n, 18)
    cos, theirs = traced(alpha, base, wi, n)
    tables = []
    for mu, weight in ((cos_theta(wo.double()), ours[:, 0].double()), (cos, theirs)):
        rows = torch.zeros(n, 16, dtype=torch.float64)
        rows[torch.arange(n), (mu.square() * 16).long().clamp(0, 15)] = weight
        tables.append((rows.mean(0), rows.std(0) / math.sqrt(n)))
    z = z_scores(*tables)
    assert z.abs().max() < 4.5 and z.square().mean() < 2
    total = [mean(w[:, None].expand(-1, 3)) for w in (ours[:, 0], theirs)]
    assert z_scores(*total).abs().max() < 4


# --- effects and samplers --------------------------------------------------------------


def test_effects():
    """Without its effect there is no medium; the columns of a condition stay."""
    material = registry.make("layered")
    clear = material.with_effects(frozenset())
    assert material.effects == {"media"} and clear.identity()["without"] == ["media"]
    condition = material.conditions(64, rng(19))
    wo = square_to_disk(torch.rand(64, 2, generator=rng(20)))
    emptied = condition.clone()
    emptied[:, [p.name for p in material.parameters].index("sigma_t")] = 0
    noise = material.noise(emptied, wo)
    off = (clear.eval(condition, wo) - material.eval(emptied, wo)).abs()
    assert (off <= 6 * noise + 1e-6).all()
    assert ((material.eval(condition, wo) - clear.eval(condition, wo)).abs() > 6 * noise).any()
    # Without a medium its albedo does not matter, but for which random numbers are drawn.
    black = layered(64, sigma_t=0.0, albedo_r=0.0)
    z = z_scores(
        albedo(layered(64, sigma_t=0.0), torch.tensor([0.5, 0.1]), 1 << 13, 21),
        albedo(black, torch.tensor([0.5, 0.1]), 1 << 13, 22),
    )
    assert z.abs().max() < 4


@pytest.mark.parametrize("wi", DIRECTIONS, ids=str)
@pytest.mark.parametrize("alpha", [0.6, 0.1])
def test_native_sampler_is_exact(alpha, wi):
    """Chi-square on the disk, and the integral of the density."""
    method = Native()
    method.bind(layered(alpha=alpha))
    n = 1 << 16
    test, integral, valid = compare(method, torch.tensor(wi), n, rng(23))
    assert test.p_value > 1e-4
    assert abs(integral - valid) < 2e-3 + 5 * math.sqrt(valid * (1 - valid) / n)


@pytest.mark.parametrize("alpha", [1e-4, 1.0])
@pytest.mark.parametrize("depth", [0.0, 50.0])
@pytest.mark.parametrize("cosine", [0.0, 1e-6, 1e-3, 1.0])
def test_extremes_are_finite(alpha, depth, cosine):
    """Grazing and horizontal, near-specular, opaque: f, weight and pdf are numbers."""
    material = layered(alpha=alpha, sigma_t=depth)
    row = torch.tensor([math.sqrt(1 - cosine**2), 0.0])
    wo, weight = exits(material, row, 2048, 24)
    assert weight.isfinite().all() and inside_disk(wo).any()
    wo = wo[inside_disk(wo)]
    condition = row.expand(len(wo), -1).contiguous()
    value = material.eval(condition, wo)
    assert value.isfinite().all() and (value >= 0).all()
    method = Native()
    method.bind(material)
    density = method.pdf(condition, wo)
    assert density.isfinite().all() and (density > 0).all()


def test_nan_stays_in_its_row():
    """And its walk ends."""
    material = registry.make("layered")
    condition = material.conditions(64, rng(25))
    u = torch.rand(64, 3, generator=rng(26))
    wo, weight = material.walk_sample(condition, u)
    f = material.eval(condition, u[:, :2] - 0.5)
    keep = torch.arange(64) != 7
    for column in range(condition.shape[1]):
        bad = condition.clone()
        bad[7, column] = math.nan
        other, dimmed = material.walk_sample(bad, u)
        assert torch.equal(other[keep], wo[keep]) and torch.equal(dimmed[keep], weight[keep])
        assert torch.equal(material.eval(bad, u[:, :2] - 0.5)[keep], f[keep])


def test_slices_share_walks_without_a_bias(monkeypatch):
    """What a slice evaluates, over many seeds, is f: the table's interpolation is not seen."""
    monkeypatch.setattr("harness.materials.families.layered.TABLE_WALKS", 256)
    material = family("layered", 512, base=0.9)
    n = 32
    condition = material.conditions(n, rng(27))
    wo = square_to_disk(torch.rand(n, 2, generator=rng(28)))
    c, at = columns_of(condition), columns_of(wo)
    row = dr.arange(mi.UInt32, n)
    shared = torch.stack(
        [tensor_of(*material.evaluator(c, seed)(row, c, at), rows=n) for seed in range(1, 25)]
    )
    z = z_scores(
        (shared.mean(0), shared.std(0) / math.sqrt(len(shared))),
        (material.eval(condition, wo), material.noise(condition, wo)),
    )
    assert z.square().mean() < 1.5 and z.mean().abs() < 0.6
