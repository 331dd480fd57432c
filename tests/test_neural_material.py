"""Neural materials: lookups, offset, decoder, and the same over Dr.Jit columns."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials.neural import textures
from harness.materials.neural.architecture import NEUMIP, Architecture
from harness.materials.neural.material import NeuralMaterial
from harness.materials.neural.network import NeuralMBTF
from harness.materials.neural.offset import shift
from harness.nets.mlp import count_parameters

SMALL = Architecture(resolution=16, offset_resolution=8, width=16, layers=2)
PYRAMID = Architecture(
    resolution=16, channels=7, pyramid=True, offset_resolution=8, offset_channels=5,
    width=12, layers=2, activation="relu", output="log1p", half_vector=True, cosines=True,
)  # fmt: skip


def network(architecture: Architecture, seed: int = 0) -> NeuralMBTF:
    """Random weights, the offset's last layer too, large enough to move lookups by texels."""
    torch.manual_seed(seed)
    net = NeuralMBTF(architecture)
    with torch.no_grad():
        net.texture.normal_()
        if net.offset is not None:
            net.offset.texture.normal_()
            net.offset.network.layers[-1].weight.normal_(0, 0.3)
    return net.eval()


def material(architecture: Architecture = SMALL, **kwargs) -> NeuralMaterial:
    return NeuralMaterial("test", network(architecture), {"type": "neural"}, **kwargs)


def queries(n: int, seed: int = 1):
    u = torch.rand(n, 6, generator=torch.Generator().manual_seed(seed))
    return 3 * u[:, :2] - 1, square_to_disk(u[:, 2:4]), square_to_disk(u[:, 4:])


# --- lookups -----------------------------------------------------------------------------------


def test_a_texel_centre_gives_its_texel():
    table = torch.randn(25, 3)
    y, x = torch.meshgrid(torch.arange(5), torch.arange(5), indexing="ij")
    uv = (torch.stack([x, y], -1).view(-1, 2) + 0.5) / 5
    assert torch.allclose(textures.lookup(table, 5, uv), table, atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(-2, 2))
def test_lookups_are_wrapped_and_bilinear(u, v, turns):
    table = torch.randn(36, 2, generator=torch.Generator().manual_seed(0)).double()
    uv = torch.tensor([[u, v]], dtype=torch.float64)
    found = textures.lookup(table, 6, uv)[0].numpy()
    image = np.pad(table.view(6, 6, 2).numpy(), ((1, 1), (1, 1), (0, 0)), mode="wrap")
    x, y = (u % 1) * 6 + 0.5, (v % 1) * 6 + 0.5
    i, j = min(int(x), 6), min(int(y), 6)
    s, t = x - i, y - j
    expected = (1 - t) * ((1 - s) * image[j, i] + s * image[j, i + 1]) + t * (
        (1 - s) * image[j + 1, i] + s * image[j + 1, i + 1]
    )
    assert np.allclose(found, expected, atol=1e-9)
    again = textures.lookup(table, 6, uv + turns)[0].numpy()
    assert np.allclose(found, again, atol=1e-9)


def test_a_level_of_the_pyramid_is_its_own_texture_and_between_two_their_mixture():
    table = torch.randn(textures.rows(8, 4), 3)
    uv = torch.rand(50, 2)
    size = textures.sides(8, 4)
    parts = table.split([s * s for s in size])
    alone = [textures.lookup(p, s, uv) for p, s in zip(parts, size, strict=True)]
    for level in range(4):
        found = textures.lookup_pyramid(table, 8, 4, uv, torch.full((50,), float(level)))
        assert torch.allclose(found, alone[level], atol=1e-4)
    found = textures.lookup_pyramid(table, 8, 4, uv, torch.full((50,), 1.25))
    assert torch.allclose(found, 0.75 * alone[1] + 0.25 * alone[2], atol=1e-4)


@pytest.mark.parametrize(("level", "end"), [(-math.inf, 0), (-3.0, 0), (9.0, 3), (math.inf, 3)])
def test_beyond_the_pyramid_its_ends_hold(level, end):
    table = torch.randn(textures.rows(8, 4), 3)
    uv = torch.rand(20, 2)
    found = textures.lookup_pyramid(table, 8, 4, uv, torch.full((20,), level))
    expected = textures.lookup_pyramid(table, 8, 4, uv, torch.full((20,), float(end)))
    assert torch.equal(found, expected)


def test_half_a_texel_is_its_own_level():
    assert float(textures.level_of(torch.tensor(0.5 / 128), 128)) == 0
    assert float(textures.level_of(torch.tensor(0.5 / 16), 128)) == 3
    assert textures.kernel_of(3, 128) == 0.5 / 16


@pytest.mark.parametrize("sigma", [0.4, 1.5, 5.0])
def test_blur_is_the_wrapped_gaussian(sigma):
    table = torch.randn(24 * 24, 2, dtype=torch.float64)
    image = table.view(24, 24, 2).numpy()
    expected = gaussian_filter(image, (sigma, sigma, 0), mode="wrap", truncate=7)
    found = textures.blur(table, 24, sigma).view(24, 24, 2).numpy()
    assert np.allclose(found, expected, atol=1e-6)
    assert textures.blur(table, 24, 0) is table


# --- the network -------------------------------------------------------------------------------


def test_the_shift_is_equation_6():
    wi = torch.tensor([[0.6, 0.0], [0.0, 0.9], [0.0, 0.0]])
    found = shift(torch.tensor([0.1, 0.1, 0.1]), wi)
    # cos = 0.8 at 0.6; at 0.9 it is 0.436, below the bound of 0.6.
    expected = torch.tensor([[0.1 / 0.8 * 0.6, 0], [0, 0.1 / 0.6 * 0.9], [0, 0]])
    assert torch.allclose(found, expected, atol=1e-7)


def test_an_untrained_offset_moves_nothing():
    torch.manual_seed(0)
    net = NeuralMBTF(SMALL)
    uv, wi, _ = queries(20)
    assert torch.equal(net.offset(uv, wi), uv)


def test_parameter_counts_of_the_papers():
    net = NeuralMBTF(NEUMIP)
    # (11 x 25 + 25) + 2 (25 x 25 + 25) + (25 x 3 + 3) and (9 x 25 + 25) + 2 (650) + 26.
    assert count_parameters(net.decoder) == 1678
    assert count_parameters(net.offset.network) == 1576
    assert net.texture.shape == (sum(4**k for k in range(10)), 7)


def test_gradients_reach_every_part():
    net = network(PYRAMID)
    uv, wi, wo = queries(64)
    net(uv, wi, wo, torch.rand(64) * 4, net.blurred(0.5)).square().sum().backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, name


# --- the material ------------------------------------------------------------------------------


@pytest.mark.parametrize("architecture", [SMALL, PYRAMID], ids=["neusample", "neumip"])
def test_columns_are_the_network(architecture):
    m = material(architecture)
    uv, wi, wo = queries(500)
    level = torch.rand(500) * 6 - 1 if architecture.pyramid else None
    condition = m.condition_at(uv, wi, level)
    with torch.no_grad():
        features = m.network.features(uv, wi, level)
        expected = m.network.reflectance(features, wi, wo)
    assert condition.shape == (500, m.n_condition)
    assert torch.allclose(condition[:, :-2], features, atol=2e-3)
    assert torch.equal(condition[:, -2:], wi)
    with torch.no_grad():
        exact = m.network.reflectance(condition[:, :-2], wi, wo)
    found = m.eval(condition, wo)
    assert torch.allclose(found, exact, atol=2e-5, rtol=1e-4)
    assert torch.allclose(found, expected, atol=2e-2, rtol=2e-2)
    target = m.target(condition, wo)
    assert torch.allclose(target, found @ torch.tensor([0.212671, 0.715160, 0.072169]), rtol=1e-4)
    assert found.min() == 0 and found.max() > 0


def test_off_the_disk_there_is_no_reflectance():
    m = material()
    condition = m.conditions(5, torch.Generator().manual_seed(0))
    wo = torch.tensor([[1.0, 0.0], [0.8, 0.8], [0.0, -1.0], [3.0, 0.0], [-0.9, 0.9]])
    assert m.eval(condition, wo).abs().sum() == 0


def test_nan_stays_nan():
    m = material()
    condition = m.conditions(2, torch.Generator().manual_seed(0))
    condition[0, 0] = math.nan
    found = m.eval(condition, torch.zeros(2, 2))
    assert found[0].isnan().all() and found[1].isfinite().all()


def test_a_grid_of_targets_is_their_rows():
    m = material()
    condition = m.conditions(4, torch.Generator().manual_seed(0))
    wo = queries(7)[2][None]
    rows = m.target(condition.repeat_interleave(7, 0), wo.expand(4, 7, 2).reshape(-1, 2))
    assert torch.equal(m.target_grid(condition, wo), rows.view(4, 7))
    own = wo.expand(4, 7, 2).contiguous()
    assert torch.equal(m.target_grid(condition, own), rows.view(4, 7))
    assert m.target_grid(condition[:0], wo).shape == (0, 7)


def test_no_rows():
    m = material()
    empty = m.conditions(0, torch.Generator())
    assert empty.shape == (0, m.n_condition)
    assert m.eval(empty, torch.empty(0, 2)).shape == (0, 3)
    assert m.target(empty, torch.empty(0, 2)).shape == (0,)


def test_effects_are_those_the_network_has_and_can_be_left_out():
    whole = material(PYRAMID)
    assert whole.effects == {"parallax", "prefiltering"} and whole.prefilters
    assert material().effects == {"parallax"}
    flat = whole.with_effects(frozenset({"texture", "prefiltering"}))
    assert flat.effects == {"prefiltering"}
    assert flat.identity() != whole.identity()
    assert whole.with_effects(whole.effects).identity() == whole.identity()
    uv, wi, _ = queries(50)
    with torch.no_grad():
        still = whole.network.features(uv, wi, torch.zeros(50), parallax=False)
    assert torch.allclose(flat.condition_at(uv, wi)[:, :-2], still, atol=2e-3)
    assert not torch.allclose(whole.condition_at(uv, wi)[:, :-2], still, atol=0.1)
    # Without prefiltering every level is the finest.
    sharp = whole.with_effects(frozenset({"parallax"}))
    level = torch.full((50,), 3.0)
    assert torch.equal(sharp.condition_at(uv, wi, level), sharp.condition_at(uv, wi))


def test_seen_from_above_nothing_moves():
    m = material()
    uv, _, _ = queries(30)
    with torch.no_grad():
        still = m.network.features(uv, torch.zeros(30, 2), parallax=False)
    assert torch.allclose(m.places(uv), still, atol=2e-3)


def test_a_description_is_checked():
    with pytest.raises(InputError, match="unknown key 'chanels'; did you mean 'channels'"):
        Architecture.of({"chanels": 8})
    with pytest.raises(InputError, match="power of two"):
        Architecture(resolution=48, pyramid=True)
    with pytest.raises(InputError, match="whole number"):
        Architecture(width=3.5)
