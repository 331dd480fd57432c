"""Importance baking: its data base, its encodings, and what is exact about its learned maps."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.core import registry
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import inside_disk, luminance, square_to_disk
from harness.core.protocol.errors import InputError, StateRefused
from harness.core.protocol.method import Budget
from harness.importance_maps import database
from harness.importance_maps.database import BakeSettings, bake, bake_to, load
from harness.importance_maps.maps import ImportanceMap
from harness.importance_maps.training import MapBatches
from harness.nets.blobs import Encoding, TableEncoder
from harness.nets.mlp import MLP
from harness.nets.tangents import with_tangents
from tests.disk import nodes
from tests.materials import MATERIALS, HalfBlack

SMALL = BakeSettings(resolution=8, slice_resolution=16)
BUDGET = Budget(steps=60, conditions=32, directions=32, pool=32)
TILTED = MATERIALS["tilted"]()


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def maps():
    return bake(TILTED, BakeSettings(resolution=16, slice_resolution=32), 32)


# --- data base -----------------------------------------------------------------------------


def test_resumed_data_base_is_the_same_to_the_bit(tmp_path, monkeypatch):
    monkeypatch.setattr(database, "SHARD", 4)
    whole, part = tmp_path / "whole", tmp_path / "part"
    assert bake_to(whole, TILTED, SMALL, 10, workers=1) == 3
    assert bake_to(part, TILTED, SMALL, 4, workers=1) == 1
    with pytest.raises(InputError, match="--resume"):
        bake_to(part, TILTED, SMALL, 10, workers=1)
    assert bake_to(part, TILTED, SMALL, 10, workers=1, resume=True) == 2
    names = sorted(f.name for f in whole.iterdir())
    assert names == sorted(f.name for f in part.iterdir())
    for name in names:
        assert (whole / name).read_bytes() == (part / name).read_bytes()
    again, few = bake(TILTED, SMALL, 10, workers=1), load(part, TILTED, 10)
    assert torch.equal(again.wo, few.wo) and torch.equal(again.condition, few.condition)
    assert len(load(part, TILTED)) == 12


def test_another_data_base_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(database, "SHARD", 4)
    bake_to(tmp_path, TILTED, SMALL, 1, workers=1)
    with pytest.raises(InputError, match="another seed: 0, not 1"):
        bake_to(tmp_path, TILTED, BakeSettings("optimal-transport", 8, 16, 1), 1, resume=True)
    with pytest.raises(InputError, match="another material than 'plain'"):
        load(tmp_path, MATERIALS["plain"](), 1)
    with pytest.raises(InputError, match="holds 4 maps, expected 100"):
        load(tmp_path, TILTED, 100)
    with pytest.raises(InputError, match="no data base"):
        load(tmp_path / "elsewhere", TILTED)


def test_black_conditions_are_left_out():
    black = HalfBlack()
    found = bake(black, SMALL, 16, workers=1)
    assert found.black == 16 - len(found) > 0
    assert (found.condition[:, 0] >= 0).all() and (found.wo[..., 0] >= -0.2).all()


def test_stored_slice_and_weights(maps):
    """What batches look up is f and p of the material, up to the width of a cell."""
    batches = MapBatches(maps)
    condition, u, wo, row = batches.draw(16, 64, rng(0))
    value, weight, pdf = batches.at(row, wo)
    f = TILTED.eval(condition.repeat_interleave(64, 0), wo.reshape(-1, 2)).view(16, 64, 3)
    assert ((value - f).abs() / f.amax()).median() < 0.02
    torch.testing.assert_close(weight * pdf[..., None], value)
    albedo = luminance(weight).mean()
    assert luminance(weight).std(1).max() < 1e-3 * albedo
    assert inside_disk(wo * (1 - 1e-6)).all() and u.min() > 0 and u.max() < 1


def test_maps_between_their_centres():
    """As ImportanceMap interpolates them, which is written differently."""
    from harness._methods.importance_baked_published import between

    maps = torch.rand(3, 5, 5, 2, generator=rng(1), dtype=torch.float64)
    u = torch.rand(3, 200, 2, generator=rng(2), dtype=torch.float64)
    u[:, 0], u[:, 1] = 0, 1 - 1e-9
    for one, points, found in zip(maps, u, between(maps, u), strict=True):
        expected = ImportanceMap(one.numpy(), one.numpy()).at(points.numpy())
        torch.testing.assert_close(found, torch.from_numpy(expected))


@pytest.mark.slow
def test_published_map_holds_between_the_centres_of_cells():
    """Of centres alone, a grid, frequencies up to 2^11 would tell nothing about the rest."""
    from harness.materials import registry as materials

    fix = {"alpha_x": 0.3, "alpha_y": 0.3}
    spec = {"name": "metal", "type": "family", "family": "ggx-conductor", "fix": fix, "walks": 1}
    material = materials.make(spec)
    made = bake(material, BakeSettings(resolution=16, slice_resolution=16), 16, workers=1)
    method = registry.make("importance-baked-published", width=32, layers=2)
    method.bind(material)
    torch.manual_seed(0)
    method.module = method.build(material)
    batches = MapBatches(made)
    method.meet(batches.condition)
    optimiser = torch.optim.Adam(method.module.parameters(), 5e-3)
    generator, budget = rng(4), Budget(steps=1, conditions=16, directions=64)
    for _ in range(400):
        loss = method.baked_loss(batches, budget, generator, 0.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    u = torch.rand(len(made), 256, 2, generator=rng(5))
    with torch.no_grad():
        encoded = method.module.encoder(made.condition)[:, None].expand(-1, 256, -1)
        found, _ = method.map(encoded, u)
    expected = torch.from_numpy(
        np.stack([
            ImportanceMap(wo.numpy(), wo.numpy()).at(v.numpy())
            for wo, v in zip(made.wo, u, strict=True)
        ])
    )  # fmt: skip
    off = (found - expected).norm(dim=-1)
    assert off.mean() < 0.1


# --- encodings and derivatives ---------------------------------------------------------------


@pytest.mark.parametrize("kind", ["freq", "blob", "identity"])
@pytest.mark.parametrize("saturating", [False, True])
def test_encoding_columns_and_derivatives(kind, saturating):
    encoding = Encoding(kind, 1 if kind == "identity" else 8, saturating)
    x = torch.rand(64, dtype=torch.float64, generator=rng(1)).requires_grad_()
    expected = encoding(x)
    assert expected.shape == (64, encoding.size)
    values, slopes = encoding.columns(columns_of(x[:, None].float())[0])
    torch.testing.assert_close(
        torch.stack([tensor_of(v, rows=64) for v in values], 1), expected.float(),
        rtol=1e-3, atol=1e-4,
    )  # fmt: skip
    for i, slope in enumerate(slopes):
        (by_x,) = torch.autograd.grad(expected[:, i].sum(), x, retain_graph=True)
        torch.testing.assert_close(tensor_of(slope, rows=64), by_x.float(), rtol=1e-3, atol=2e-3)


def test_widths_of_table_1():
    """Table 1: 8 + 12 + 24 numbers for a conductor, 13 + 3 + 24 for layers, 16 + 24 for Disney."""
    from harness.materials import registry as materials

    widths = {"ggx-conductor": 44, "layered": 40, "disney": 40}
    for name, width in widths.items():
        assert TableEncoder(materials.make(name)).width == width


def test_tangents_of_a_network():
    torch.manual_seed(0)
    mlp = MLP([3, 16, 16, 2], "leaky_relu")
    x, t = torch.randn(2, 32, 3, generator=rng(2)).unbind(0)
    _, expected = torch.func.jvp(mlp, (x,), (t,))
    _, (found,) = with_tangents(mlp, columns_of(x), [columns_of(t)])
    torch.testing.assert_close(tensor_of(*found, rows=32), expected, rtol=1e-4, atol=1e-5)


# --- the monotone map --------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["both", "map", "likelihood"])
def baked(request):
    method = registry.make("importance-baked", resolution=16, supervision=request.param)
    report = method.fit(TILTED, BUDGET, rng(3))
    assert report.notes == "32 importance maps" and math.isfinite(report.loss[-1])
    return method


def test_density_integrates_to_one(baked):
    wo, weight, _ = nodes()
    row = TILTED.conditions(1, rng(4))
    total = (baked.pdf(row.expand(len(wo), -1), wo).double() * weight).sum()
    assert total == pytest.approx(1, abs=2e-3)


def test_density_is_one_over_the_jacobian_of_sampling(baked):
    """By finite differences through the sampler, an independent way to the same number."""
    condition = TILTED.conditions(256, rng(5))
    u = torch.rand(256, 3, generator=rng(6)) * 0.9 + 0.05
    u[:, 2] = 0.5
    step, columns = 1e-3, []
    for i in (0, 1):
        move = torch.zeros(3)
        move[i] = step
        ahead, behind = (baked.sample(condition, u + s * move).wo for s in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    det = torch.linalg.det(torch.stack(columns, -1).double())
    assert (det > 0).all(), "the map folds"
    share = baked.uniform
    density = (1 - share) / det + share / math.pi
    pdf = baked.sample(condition, u).pdf.double()
    assert ((density / pdf - 1).abs() < 0.05).double().mean() > 0.95


@pytest.mark.parametrize(("gain", "refused"), [(1.0, False), (30.0, True)])
def test_a_state_that_rounding_moves_is_refused(gain: float, refused: bool):
    """Networks as fitted pass; of thirty times their weights, rounding moves some samples."""
    method = registry.make("importance-baked", slices=32, resolution=16)
    method.fit(TILTED, BUDGET, rng(3))
    assert method.unsteady() == 0
    scaled = {
        name: value * gain if name.endswith("weight") else value
        for name, value in method.state_dict().items()
    }
    again = registry.make("importance-baked", slices=32, resolution=16)
    again.bind(TILTED)
    if not refused:
        again.load_state_dict(scaled)
        return
    with pytest.raises(StateRefused, match="importance-baked: state refused") as error:
        again.load_state_dict(scaled)
    assert error.value.number == again.unsteady() > 0


def test_fit_lowers_the_divergence(baked):
    """Against the untrained map, on conditions that the fit has not seen."""
    blank = registry.make("importance-baked", resolution=16)
    blank.bind(TILTED)
    condition = TILTED.conditions(64, rng(7))
    wo = square_to_disk(torch.rand(64, 256, 2, generator=rng(8)))
    target = TILTED.target_grid(condition, wo)
    target = (target / target.mean(1, keepdim=True)).flatten()
    rows, points = condition.repeat_interleave(256, 0), wo.flatten(0, 1)
    kl = [-(target * m.pdf(rows, points).log()).mean() for m in (baked, blank)]
    assert kl[0] < kl[1] - 0.1


# --- the published networks ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def signed():
    """Trained for a moment: the identities hold for any network."""
    method = registry.make("importance-baked-signed", width=16, layers=2, resolution=16)
    method.fit(TILTED, BUDGET, rng(9))
    return method


def test_signed_jacobian_against_autograd(signed):
    condition = TILTED.conditions(64, rng(10))
    u = torch.rand(64, 2, generator=rng(11)) * 0.98 + 0.01
    encoded = signed.module.encoder(condition)
    expected = []
    for k in range(64):
        jacobian = torch.autograd.functional.jacobian(
            lambda v, k=k: signed.map(encoded[k : k + 1], v)[0][0], u[k : k + 1]
        )[:, 0]
        expected.append(torch.linalg.det(jacobian))
    x, y, det = signed.jacobian_columns(
        signed.module.encoder.columns(columns_of(condition)), columns_of(u)
    )
    torch.testing.assert_close(tensor_of(det, rows=64), torch.stack(expected), rtol=1e-2, atol=1e-2)
    wo = signed.map(encoded, u)[0].detach()
    torch.testing.assert_close(tensor_of(x, y, rows=64), wo, rtol=1e-3, atol=1e-4)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 1000), gain=st.floats(0.5, 6))
def test_signed_weights_are_unbiased_even_where_the_map_folds(signed, seed, gain):
    """Mean weight against the albedo, of networks made worse until they fold."""
    method = copy.deepcopy(signed)
    with torch.no_grad():
        method.module.sampling.layers[-1].weight.mul_(gain)
    row = TILTED.conditions(1, rng(seed))
    side = 512
    corner = torch.stack(torch.meshgrid(*[torch.arange(side)] * 2, indexing="xy"), -1)
    u = (corner.view(-1, 2) + torch.rand(side * side, 2, generator=rng(seed))) / side
    u = torch.cat([u, torch.zeros(len(u), 1)], 1)
    weight = method.sample_weighted(row.expand(len(u), -1), u).weight.double()
    wo, area, _ = nodes()
    albedo = (TILTED.eval(row.expand(len(wo), -1), wo).double() * area[:, None]).sum(0)
    # Stratified: the error is below that of as many independent samples.
    error = 4 * weight.std(0) / side + 2e-3 * albedo
    assert ((weight.mean(0) - albedo).abs() < error).all()


def test_signed_weights_are_negative_where_the_map_folds(signed):
    """So that the test before this one has seen folds."""
    method = copy.deepcopy(signed)
    with torch.no_grad():
        method.module.sampling.layers[-1].weight.mul_(6)
    condition, u = TILTED.conditions(4096, rng(15)), torch.rand(4096, 3, generator=rng(16))
    assert (method.sample_weighted(condition, u).weight < 0).any()


def test_published_weights_are_what_the_network_says():
    method = registry.make("importance-baked-published", width=16, layers=2, resolution=16)
    report = method.fit(TILTED, BUDGET, rng(12))
    assert not method.exact_pdf and "biased" in report.notes
    condition, u = TILTED.conditions(512, rng(13)), torch.rand(512, 3, generator=rng(14))
    drawn = method.sample_weighted(condition, u)
    wo, log_weight = method.map(method.module.encoder(condition), u[:, :2])
    torch.testing.assert_close(drawn.wo, wo.detach(), rtol=1e-3, atol=1e-3)
    inside = inside_disk(drawn.wo)
    assert (drawn.weight[~inside] == 0).all()
    expected = log_weight.detach().expm1()[inside]
    torch.testing.assert_close(drawn.weight[inside], expected, rtol=1e-3, atol=1e-3)
    assert (method.pdf(condition, square_to_disk(u[:, :2])) > 0).all()
    assert (method.eval(condition, square_to_disk(u[:, :2])) > 0).all()
    outside = torch.full((512, 2), 0.8)
    assert not method.pdf(condition, outside).any() and not method.eval(condition, outside).any()


def test_one_network_needs_a_density():
    method = registry.make("importance-baked-one-network")
    able, reason = method.supports(TILTED)
    assert not able and "no density of its own" in reason


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"supervision": "both."}, "supervision is 'both.'"),
        ({"kind": "optimal"}, "did you mean 'optimal-transport'"),
        ({"resolution": 1}, "at least 2"),
        ({"bins": 1}, "expected 2 to 499"),
    ],
)
def test_refused_parameters(params, words):
    with pytest.raises(InputError, match=words):
        registry.make("importance-baked", **params)
