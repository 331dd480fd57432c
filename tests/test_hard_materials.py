"""The materials that are hard on purpose: what each promises, against independent integrals."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.checks.catalogue import BASE, CATALOGUE
from harness.core.protocol.disk import inside_disk, luminance, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.fitting.targets import Targets
from harness.materials import registry
from harness.materials.hard.base import DiskMaterial
from harness.materials.hard.flat import BrightPixel
from harness.materials.hard.holes import MeasuredHoles
from harness.materials.hard.registry import MATERIALS

NAMES = registry.hard_names()
SYNTHETIC = [n for n in NAMES if not n.startswith(("specular", "anisotropic"))]
METALS = [n for n in NAMES if n not in SYNTHETIC]
BUDGET = Budget(steps=120, conditions=64, directions=32, resolution=32, pool=256)

each = pytest.mark.parametrize("name", NAMES)
synthetic = pytest.mark.parametrize("name", SYNTHETIC)
metals = pytest.mark.parametrize("name", METALS)


def rows(material: Material, *wi: tuple[float, float]) -> Tensor:
    """Conditions [len(wi), C] at random places."""
    found = material.conditions(len(wi), torch.Generator().manual_seed(5)).clone()
    found[:, -2:] = torch.tensor(wi)
    return found


def polar(material: Material, row: Tensor, radii: int = 512, turns: int = 4096) -> float:
    """Integral of the target over the disk: Gauss points along r, equal steps around.

    Neither the rim nor a lobe across it is cut by the grid.
    """
    node, weight = np.polynomial.legendre.leggauss(radii)
    radius = torch.from_numpy(0.5 * (node + 1)).float()
    area = torch.from_numpy(0.5 * weight) * radius.double() * (2 * math.pi / turns)
    total = 0.0
    for turn in ((torch.arange(turns) + 0.5) * (2 * math.pi / turns)).split(512):
        circle = torch.stack([turn.cos(), turn.sin()], -1)
        wo = (radius[:, None, None] * circle).reshape(1, -1, 2)
        value = material.target_grid(row[None], wo).double().view(radii, -1)
        total += float((value.sum(1) * area).sum())
    return total


# --- all of them -----------------------------------------------------------------------


def test_the_names():
    families = set(registry.family_names())
    assert set(NAMES) == {case.material for case in CATALOGUE.values()} - {BASE} - families
    assert not set(NAMES) & set(registry.names())
    assert all(registry.describe(n) and "\n" not in registry.describe(n) for n in NAMES)


@each
def test_made_by_name_and_by_type(name):
    """A bare name and ``type: hard`` are the same material, with the same identity."""
    written = {"name": name, "type": "hard"}
    material = registry.make(name)
    assert material.name == name
    assert material.identity() == registry.identity(name) == registry.identity(written)
    assert registry.identity({"name": name}) == registry.identity(name)
    assert material.identity()["name"] == name and "/" not in json.dumps(material.identity())


def test_identities_differ():
    assert len({json.dumps(registry.identity(n)) for n in NAMES}) == len(NAMES)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("rim-lob", "unknown material 'rim-lob'; did you mean 'rim-lobe'?"),
        ({"name": "rim-lob", "type": "hard"}, "unknown hard material 'rim-lob'; did you mean"),
        ({"name": "rim-lobe", "type": "hard", "sigma": 1}, "unknown key 'sigma'"),
        ({"name": "rim-lobe", "type": "hart"}, "did you mean 'hard'"),
    ],
)
def test_refused(spec, message):
    for call in (registry.validate, registry.identity, registry.make):
        with pytest.raises(InputError) as refused:
            call(spec)
        assert message in str(refused.value) and "\n" not in str(refused.value)


@each
def test_finite_everywhere(name):
    """At any wi, grazing, horizontal and rounded beyond the rim; zero outside the disk."""
    material = registry.make(name)
    generator = torch.Generator().manual_seed(1)
    inner = square_to_disk(torch.rand(24, 2, generator=generator))
    turn = torch.rand(8, generator=generator) * 2 * math.pi
    rim = torch.stack([turn.cos(), turn.sin()], -1)
    wi = torch.cat([inner, rim, (1 + 1e-7) * rim, 0.9999 * rim, torch.tensor([[0.0, 0], [1, 0]])])
    condition = material.conditions(len(wi), generator).clone()
    condition[:, -2:] = wi
    wo = torch.cat([square_to_disk(torch.rand(512, 2, generator=generator)), wi, -wi, 1.5 * rim])
    a, b = condition.repeat_interleave(len(wo), 0), wo.repeat(len(wi), 1)
    value = material.eval(a, b)
    assert value.shape == (len(a), 3) and value.isfinite().all()
    # On the rim itself rounding decides, here and in Mitsuba.
    assert (value[b.double().square().sum(1) > 1 + 1e-6] == 0).all()
    assert name == "measured-holes" or (value >= 0).all()


@each
def test_calls_of_no_rows(name):
    material = registry.make(name)
    condition, wo = material.conditions(0, torch.Generator()), torch.empty(0, 2)
    assert material.eval(condition, wo).shape == (0, 3)
    assert material.target(condition, wo).shape == (0,)


@each
def test_the_grid_is_the_target(name):
    """``target_grid`` gives what ``target`` gives, for shared and for own directions."""
    material, generator = registry.make(name), torch.Generator().manual_seed(2)
    condition = material.conditions(7, generator)
    for count in (1, 7):
        wo = square_to_disk(torch.rand(count, 50, 2, generator=generator))
        expected = Material.target_grid(material, condition, wo)
        found = material.target_grid(condition, wo)
        # Below the least normal number the digits run out.
        tiny = torch.finfo(torch.float32).tiny
        torch.testing.assert_close(found, expected, rtol=1e-5, atol=tiny)


@each
def test_targets_can_be_drawn(name):
    """The budget of a check gives normalised weights; black conditions are left out."""
    targets = Targets.build(registry.make(name), BUDGET, torch.Generator().manual_seed(3))
    assert targets.mass.isfinite().all() and len(targets.condition) + targets.black == 256
    torch.testing.assert_close(targets.mass.sum(1), torch.ones(len(targets.mass)))
    assert (targets.black > 0) == (name == "black-texels")


# --- closed forms ----------------------------------------------------------------------


@synthetic
def test_albedo(name):
    """The closed form is the integral of the target over the disk, and not above one."""
    material = registry.make(name)
    condition = rows(material, (0.06, 0.08), (-0.72, 0.54), (0.9, -0.3))
    found = material.albedo(condition)
    assert found.shape == (3,) and found.dtype == condition.dtype
    assert (found <= 1 + 1e-6).all()
    if name == "bright-pixel":
        return  # A polar grid does not see it: below.
    for row, albedo in zip(condition, found.tolist(), strict=True):
        assert albedo == pytest.approx(polar(material, row), rel=2e-3, abs=1e-7)


def test_albedo_of_the_bright_pixel():
    """Base everywhere, and the pixel's own energy on a fine grid around it."""
    material = registry.make("bright-pixel")
    (centre,) = material.peaks(rows(material, (0.1, 0.2)))[0]
    step = BrightPixel.WIDTH / 256
    axis = (torch.arange(1024) - 511.5) * step
    wo = centre + torch.cartesian_prod(axis, axis)
    value = material.target_grid(torch.zeros(1, 2), wo[None]).double()
    pixel = float((value - BrightPixel.BASE).sum() * step**2)
    whole = pixel + BrightPixel.BASE * math.pi
    assert material.albedo(torch.zeros(1, 2)).item() == pytest.approx(whole, rel=5e-3)
    assert pixel / whole == pytest.approx(0.92, abs=0.01)


@synthetic
@settings(max_examples=20, deadline=None)
@given(radius=st.floats(0, 1), turn=st.floats(0, 2 * math.pi), u=st.floats(0, 1), v=st.floats(0, 1))
def test_albedo_keeps_energy(name, radius, turn, u, v):
    """0 <= albedo <= 1 for any wi and place."""
    material = registry.make(name)
    wi = torch.tensor([[radius * math.cos(turn), radius * math.sin(turn)]])
    condition = torch.cat([material.places(torch.tensor([[u, v]])), wi], 1)
    assert 0 <= material.albedo(condition).item() <= 1 + 1e-6


@synthetic
def test_peaks_are_where_f_is_largest(name):
    """Nowhere on the disk is f larger than at one of the peaks, as far as these lie on it."""
    material = registry.make(name)
    condition = rows(material, (0.06, 0.08), (-0.72, 0.54), (0.3, -0.9))
    if name == "black-texels":
        condition[:, 0] = 1
    peaks = material.peaks(condition)
    assert peaks.shape[0] == 3 and peaks.shape[2] == 2
    if name in ("constant", "black-hemisphere", "measured-holes"):
        assert peaks.shape[1] == 0
        return
    if name == "below-horizon":
        assert not inside_disk(peaks).any()
        return
    grid = square_to_disk(torch.rand(1, 1 << 15, 2, generator=torch.Generator().manual_seed(4)))
    at_peaks = material.target_grid(condition, peaks).amax(1)
    assert (at_peaks >= 0.999 * material.target_grid(condition, grid).amax(1)).all()


# --- what is hard about each ------------------------------------------------------------


@metals
@settings(max_examples=20, deadline=None)
@given(slope=st.floats(0, 1.5), turn=st.floats(0, 2 * math.pi))
def test_metals_are_as_rough_as_named(name, slope, turn):
    """At normal incidence f = F D(h) G_1(wo) / (4 cos), by GGX of the named roughness.

    ``slope``: of the half vector, in units of the roughness. F is some 0.92 for aluminium.
    """
    material = registry.make(name)
    alpha = {"anisotropic-100": (0.5, 0.005)}.get(name) or (float(name[9:]),) * 2
    u, v = alpha[0] * slope * math.cos(turn), alpha[1] * slope * math.sin(turn)
    squared = u * u + v * v
    wo = torch.tensor([[u, v]], dtype=torch.float64) * 2 / (1 + squared)
    wo = wo.float()
    # The half vector of the rounded direction: a lobe this narrow feels the rounding.
    x, y = wo[0].tolist()
    z = math.sqrt(1 - x * x - y * y)
    u, v = x / (1 + z), y / (1 + z)
    cos_squared = 1 / (1 + u * u + v * v)
    stretched = (u / alpha[0]) ** 2 + (v / alpha[1]) ** 2
    ndf = 1 / (math.pi * alpha[0] * alpha[1] * (cos_squared * (1 + stretched)) ** 2)
    masking = 2 / (1 + math.sqrt(1 + ((alpha[0] * x) ** 2 + (alpha[1] * y) ** 2) / z**2))
    value = luminance(material.eval(torch.zeros(1, 2), wo)).item()
    assert value * 4 * z / (ndf * masking) == pytest.approx(0.92, abs=0.02)


def test_below_the_horizon():
    """The share of the lobe that is above the horizon is as documented."""
    material = registry.make("below-horizon")
    condition = rows(material, (1.0, 0.0), (0.0, 0.0), (-1.0, 0.0))
    most, normal, least = material.albedo(condition).tolist()
    assert 0.25 < most < 0.31 and 0.05 < normal < 0.1 and 0.01 < least < 0.025


def test_rim_lobe_is_cut_in_two():
    material = registry.make("rim-lobe")
    share = (material.albedo(rows(material, (0.2, 0.1))).item() - 0.1) / 0.5
    assert 0.5 < share < 0.56


def test_distant_lobes():
    """Far apart in units of their widths, and on the disk, at every wi."""
    material = registry.make("distant-lobes")
    condition = material.conditions(256, torch.Generator().manual_seed(6))
    peaks = material.peaks(condition)
    sigmas = torch.tensor([lobe[1] for lobe in material.LOBES])
    energies = torch.tensor([lobe[0] for lobe in material.LOBES])
    shares = (energies / energies.sum()).tolist()
    assert shares == pytest.approx([0.5, 0.25, 0.16, 0.08, 0.01])
    apart = torch.cdist(peaks, peaks) / (sigmas[:, None] + sigmas)
    assert apart[:, ~torch.eye(5, dtype=torch.bool)].min() > 3
    assert inside_disk(peaks).all()


def test_black_texels():
    """Half of the tile is black, and exactly so."""
    material = registry.make("black-texels")
    u = torch.rand(1 << 14, 2, generator=torch.Generator().manual_seed(7))
    value = material.places(u)
    assert set(value.unique().tolist()) == {0.0, 1.0}
    assert value.mean() == pytest.approx(0.5, abs=0.02)
    black, lit = (material.eval(torch.tensor([[t, 0.3, 0.2]]), torch.zeros(1, 2)) for t in (0.0, 1))
    assert (black == 0).all() and (lit > 0).all()


def test_black_hemisphere():
    material = registry.make("black-hemisphere")
    wo = torch.tensor([[1e-30, 0.5], [0.0, 0.5], [-0.0, 0.5], [-0.3, 0.2], [0.9, 0.1]])
    value = material.eval(torch.zeros(5, 2), wo)[:, 0]
    assert (value > 0).tolist() == [False, True, True, True, False]


def test_measured_holes():
    """Sectors of their width are negative, and exactly zero; the target covers the first."""
    material = registry.make("measured-holes")
    turn = (torch.arange(20_000) + 0.5) * (2 * math.pi / 20_000)
    wo = 0.7 * torch.stack([turn.cos(), turn.sin()], -1)
    condition = torch.tensor([[0.4, -0.3]]).expand(len(wo), 2)
    value = material.eval(condition, wo)
    for found, sector in ((value == 0, MeasuredHoles.HOLE), (value < 0, MeasuredHoles.NEGATIVE)):
        width = found[:, 0].double().mean().item() * 2 * math.pi
        assert width == pytest.approx(sector[1] - sector[0], abs=2e-3)
    assert torch.equal(material.target(condition, wo) == 0, (value == 0).all(1))


def test_blue_only():
    material = registry.make("blue-only")
    value = material.eval(torch.tensor([[0.3, 0.2]]), torch.tensor([[-0.2, -0.1]]))[0]
    assert value[0] == value[1] == 0 < value[2]


def test_none_needs_a_renderer_but_the_metals():
    assert all(isinstance(registry.make(n), DiskMaterial) for n in SYNTHETIC)
    assert set(SYNTHETIC) | set(METALS) == set(MATERIALS)
