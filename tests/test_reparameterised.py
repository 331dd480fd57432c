"""The triangular map: a bijection for any weights, with its exact density; what it is made of."""

from __future__ import annotations

import math

import drjit.llvm.ad as llvm
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.core import registry
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError, StateRefused, Unsupported
from harness.core.protocol.method import Budget
from harness.fitting.drawn import GROUPS, Drawn
from harness.fitting.map_degree import examine
from harness.fitting.reverse import LEAST, Pool, normal_of_uniforms, stratified_uniforms
from harness.fitting.targets import Targets, cells
from harness.materials import registry as materials
from harness.nets import hemisphere, plane, spline
from harness.nets.mlp import MLP
from harness.nets.tangents import slopes_by_last, slopes_by_last_columns
from tests.materials import HalfBlack, Plain, Tilted

TILTED = Tilted()
BUDGET = Budget(steps=25, conditions=64, directions=32, resolution=32, pool=256)


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def with_weights(seed: int, size: float, **params):
    """The method with random weights, in double precision; last layers of that size."""
    method = registry.make("reparameterised", **params)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        method.bind(TILTED)
        with torch.no_grad():
            for net in (method.module.first, method.module.second):
                for p in net.layers[-1].parameters():
                    p.add_(size * torch.randn_like(p))
    method.module.double()
    return method


def logistic(n: int, d: int, seed: int) -> torch.Tensor:
    return torch.logit(torch.rand(n, d, 2, generator=rng(seed), dtype=torch.float64), eps=1e-9)


# --- a bijection ----------------------------------------------------------------------


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6), st.floats(0, 0.6))
def test_every_direction_has_the_one_preimage(seed, size):
    """There and back; the Jacobian's determinant is positive and the density's."""
    method = with_weights(seed, size, width=8)
    condition, z = TILTED.conditions(20, rng(1)).double(), logistic(20, 4, 2)
    with torch.no_grad():
        wo = method.from_base(method.module, condition, z)
        back, log_slope = method.to_base(method.module, condition, wo)
    assert (wo.square().sum(-1) <= 1).all()
    # Where the direction still says where it came from: off the last bits before the rim.
    known = wo.square().sum(-1) < 1 - 1e-6
    error = (back - z).abs().amax(-1) * known
    assert (error <= 1e-9 * (1 + torch.exp(log_slope)) * known).all()

    def one(v):
        return method.from_base(method.module, condition[:1], v[None, None])[0, 0]

    for v, slope, ok in zip(z[0], log_slope[0], known[0], strict=True):
        if ok:
            det = torch.linalg.det(torch.autograd.functional.jacobian(one, v))
            assert det > 0
            assert math.isclose(float(det.log()), -float(slope), rel_tol=1e-6, abs_tol=1e-5)


@pytest.mark.parametrize("seed", range(10))
def test_the_degree_is_one(seed):
    """By the same measure that finds folds and holes in a free map, and it finds none."""
    method = with_weights(seed, 0.4, width=8)

    def map_(condition, z):
        # Stretched, the circle goes around all that matters of p*, whatever the scales.
        wo = method.from_base(method.module, condition.double(), 5 * z.double())
        slope = method.to_base(method.module, condition.double(), wo)[1]
        return wo.float(), torch.exp(-slope).float()

    found = examine(map_, TILTED, TILTED.conditions(4, rng(seed)), rng(1), samples=256)
    assert found.folded == 0 and found.repeated == 0 and found.missed < 0.02


def test_samples_are_the_map_of_their_uniforms():
    method = with_weights(3, 0.15)
    condition, u = TILTED.conditions(4000, rng(4)), torch.rand(4000, 3, generator=rng(5))
    u[:, 2] = 1 - 2.0**-24
    with torch.no_grad():
        z = torch.logit(u[:, None, :2].double())
        expected = method.from_base(method.module, condition.double(), z)[:, 0]
    wo = method.sample(condition, u).wo
    assert ((wo - expected).abs().amax(1) < 2e-5).float().mean() > 0.999


def test_uniform_share_in_the_same_kernel():
    """Samples of the share are uniform on the disk, and their density is that of a query."""
    method = with_weights(6, 0.5, uniform=0.25)
    condition, u = TILTED.conditions(5000, rng(7)), torch.rand(5000, 3, generator=rng(8))
    u[:, 2] *= 0.25
    wo, pdf = method.sample(condition, u)
    torch.testing.assert_close(wo.square().sum(1), u[:, 0], rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(method.pdf(condition, wo), pdf, rtol=1e-4, atol=0)
    assert (pdf >= 0.2499 / math.pi).all()


@pytest.mark.parametrize("name", ["scale-to-0", "scale-to-infinity"])
def test_extreme_states_are_refused_or_right(name):
    method = registry.make("reparameterised")
    method.bind(TILTED)
    state = method.extremes()[name]
    try:
        method.load_state_dict(state)
    except StateRefused as error:
        assert "rounding" in str(error)
        return
    condition, u = TILTED.conditions(4096, rng(9)), torch.rand(4096, 3, generator=rng(10))
    wo, pdf = method.sample(condition, u)
    assert wo.isfinite().all() and pdf.isfinite().all()
    torch.testing.assert_close(method.pdf(condition, wo), pdf, rtol=1e-4, atol=0)


# --- fitting --------------------------------------------------------------------------


def test_likelihood_and_both_objectives_learn():
    losses = {}
    for objective in ("forward", "both"):
        method = registry.make("reparameterised", objective=objective)
        report = method.fit(TILTED, BUDGET, rng(11))
        assert report.steps == BUDGET.steps and report.parameters > 1000
        losses[objective] = report.loss[0] - report.loss[-1]
    assert losses["forward"] > 0.2 and losses["both"] > 0.4


@pytest.mark.parametrize(("shift", "some_round"), [(0.0, False), (14.0, True)])
def test_reverse_loss_of_samples_that_round_onto_the_rim(shift, some_round):
    """They count like all others: their density is that of the point before it is rounded."""
    method = registry.make("reparameterised", objective="both")
    method.bind(TILTED)
    n = spline.outputs(method.bins)
    with torch.no_grad():
        method.module.first.layers[-1].bias[n + 2] = shift
    condition = TILTED.conditions(64, rng(0))
    z = torch.logit(stratified_uniforms(64, 32, rng(1), "cpu"), eps=2.0**-25)
    wo, log_p = method.density_of_drawn(condition, z)
    there = method.followed(wo)
    assert there.any() and bool((~there).any()) is some_round
    assert log_p.isfinite().all()
    targets = Targets.build(TILTED, BUDGET, rng(2))
    loss = method.loss(targets, BUDGET, rng(3))
    loss.backward()
    assert loss.isfinite()
    assert all(p.grad.isfinite().all() for p in method.module.parameters() if p.grad is not None)


def test_density_of_what_is_drawn_is_the_density_of_its_direction():
    method = registry.make("reparameterised", objective="both")
    method.bind(TILTED)
    method.module.double()
    condition = TILTED.conditions(64, rng(0)).double()
    z = torch.logit(stratified_uniforms(64, 32, rng(1), "cpu").double(), eps=2.0**-25)
    wo, log_p = method.density_of_drawn(condition, z)
    torch.testing.assert_close(log_p, method.log_prob(condition, wo), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(wo, method.from_base(method.module, condition, z))


def test_reverse_loss_is_the_divergence_of_the_mixture():
    """Against quadrature over the disk: the uniform branch counts by its share, and its samples."""
    method = registry.make("reparameterised", objective="both")
    method.bind(TILTED)
    condition = TILTED.conditions(8, rng(0))

    def by_cells(resolution: int) -> float:
        wo = cells(resolution)[None].expand(8, -1, -1)
        log_p = method.log_prob(condition, wo).double()
        log_f = (TILTED.target_grid(condition, wo) + LEAST).log()
        return float(math.pi * (log_p.exp() * (log_p - log_f)).mean())

    for raw in (-3.0, 1.0):
        with torch.no_grad():
            method.module.first.layers[-1].bias[-1] = raw
            found = float(method.mixture_divergence(condition, 65536, rng(4)))
            # What cells miss at the rim is in proportion to their size.
            expected = 2 * by_cells(256) - by_cells(128)
        assert abs(found - expected) < 2e-3


def test_directions_near_the_rim_are_moved_in():
    wo = torch.tensor([[0.0, 0.0], [0.6, 0.0], [0.6, 0.8], [-1.0, 0.0], [1 - 2.0**-20, 0.0]])
    moved = plane.off_the_rim(wo)
    assert torch.equal(moved[:2], wo[:2])
    torch.testing.assert_close(moved[2:].norm(dim=-1), torch.full((3,), 1 - plane.RIM))
    torch.testing.assert_close(moved, wo, rtol=0, atol=2.0**-15)


def test_both_objectives_need_a_gradient():
    walks = materials.make("ggx-conductor")
    method = registry.make("reparameterised", objective="both")
    able, reason = method.supports(walks)
    assert not able and "random walks" in reason
    with pytest.raises(Unsupported, match="random walks"):
        method.fit(walks, BUDGET, rng(12))
    assert registry.make("reparameterised").supports(walks)[0]


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"objective": "reverse"}, "expected 'forward' or 'both'"),
        ({"bins": 1}, "expected 2 to 499"),
        ({"width": 0}, "at least one"),
        ({"uniform": 1.0}, "uniform"),
        ({"precision": "half"}, "precision"),
    ],
)
def test_refused_parameters(params, words):
    with pytest.raises(InputError, match=words):
        registry.make("reparameterised", **params)


def test_drawn_directions_follow_their_mass():
    targets = Targets.build(TILTED, Budget(pool=4), rng(13))
    drawn = Drawn(targets, 256, rng(14))
    assert drawn.wo.shape == (4, GROUPS, 256, 2) and inside_disk(drawn.wo).all()
    for mass, wo, found in zip(targets.mass, targets.wo, drawn.wo, strict=True):
        same = torch.cdist(wo.double(), found.flatten(0, 1).double()) == 0
        observed, expected = same.sum(1).double(), mass.double() * GROUPS * 256
        # Stratified: no direction is off by more than two, where independent draws would be.
        assert ((observed - expected).abs() <= 2 + 1e-3 * expected).all()


def test_uniforms_are_in_their_cells():
    u = stratified_uniforms(5, 40, rng(16), "cpu")
    assert u.shape == (5, 36, 2) and (u < 1).all()
    cell = (u * 6).long()
    flat = (cell[..., 0] * 6 + cell[..., 1]).sort(1).values
    assert torch.equal(flat, torch.arange(36).expand(5, -1))
    z = normal_of_uniforms(stratified_uniforms(1, 1 << 16, rng(17), "cpu"))
    assert z.mean().abs() < 5e-3 and (z.var() - 1).abs() < 1e-2


class Black(Plain):
    """Reflects nothing."""

    name = "black"

    def eval(self, condition, wo):
        return 0 * super().eval(condition, wo)


def test_black_conditions():
    pool = Pool.draw(HalfBlack(), Budget(pool=200), rng(18))
    assert pool.black + len(pool.condition) == 200 and 60 < pool.black < 140
    assert (pool.condition[:, 0] >= 0).all()
    with pytest.raises(InputError, match="'black' is black in all 8 conditions"):
        Pool.draw(Black(), Budget(pool=8), rng(19))
    with pytest.raises(InputError, match="black in all 5 conditions"):
        examine(lambda c, z: (z, z[..., 0]), Black(), Black().conditions(5, rng(20)), rng(21))


# --- building blocks ------------------------------------------------------------------


def test_plane_and_disk():
    ab = 3 * torch.randn(200, 2, generator=rng(22), dtype=torch.float64)
    wo = plane.disk_of_plane(*ab.unbind(1))
    at = plane.plane_of_disk(wo)
    torch.testing.assert_close(torch.stack([at.a, at.b], 1), ab, rtol=1e-6, atol=1e-6)
    jacobian = torch.autograd.functional.jacobian(
        lambda v: plane.disk_of_plane(*v.unbind(1)).sum(0), ab
    )
    det = torch.linalg.det(jacobian.permute(1, 0, 2))
    assert (det > 0).all()
    torch.testing.assert_close(-det.log(), at.log_density, rtol=1e-5, atol=1e-5)
    wo = wo.float()
    x, y = columns_of(wo)
    b, density = plane.b_columns(x, y)
    found = tensor_of(plane.a_columns(x), b, density, rows=200).double()
    exact = plane.plane_of_disk(wo.double())
    expected = torch.stack([exact.a, exact.b, exact.log_density.exp()], 1)
    near = wo.norm(dim=1) < 0.99999
    torch.testing.assert_close(found[near], expected[near], rtol=2e-3, atol=1e-5)
    off = torch.tensor([[1.0, 0.0], [-1.0, 0.3], [0.0, 1.0], [3.0, -4.0]])
    x, y = columns_of(off)
    _, density = plane.b_columns(x, y)
    assert not density.numpy().any() and np.isfinite(plane.a_columns(x).numpy()).all()
    assert (plane.plane_of_disk(off).log_density == -math.inf).all()


def test_silu_slopes_in_torch_and_over_columns():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        net = MLP([7, 16, 16, 3], "silu").double()
    head, tail = torch.randn(9, 5, generator=rng(23)).double(), torch.randn(9, 1, 2).double()
    out, slopes = slopes_by_last(net, head, tail)
    whole = torch.cat([head, tail[:, 0]], 1)
    torch.testing.assert_close(out[:, 0], net(whole))
    full = torch.autograd.functional.jacobian(lambda v: net(v).sum(0), whole)
    torch.testing.assert_close(slopes[:, :, 0], full.permute(2, 1, 0)[5:])
    columns = [llvm.Float(c) for c in whole.float().T.numpy()]
    x, (by_0, by_1) = slopes_by_last_columns(net, columns, 2)
    torch.testing.assert_close(tensor_of(*x, rows=9), out[:, 0].float(), rtol=1e-4, atol=1e-5)
    found = torch.stack([tensor_of(*by_0, rows=9), tensor_of(*by_1, rows=9)])
    torch.testing.assert_close(found, slopes[:, :, 0].float(), rtol=1e-4, atol=1e-5)


def test_hemisphere_determinant():
    raw = 2 * torch.randn(50, 3, generator=rng(24), dtype=torch.float64)
    by = torch.randn(2, 50, 3, generator=rng(25), dtype=torch.float64)
    wo, det = hemisphere.direction_and_determinant(raw, by)
    torch.testing.assert_close(wo, hemisphere.direction(raw))
    assert inside_disk(wo).all()
    full = torch.autograd.functional.jacobian(lambda v: hemisphere.direction(v).sum(0), raw)
    expected = torch.linalg.det(full.permute(1, 0, 2) @ by.permute(1, 2, 0))
    torch.testing.assert_close(det, expected)
    columns = [llvm.Float(c) for c in raw.float().T.numpy()]
    slopes = [[llvm.Float(c) for c in t.float().T.numpy()] for t in by]
    found = tensor_of(*hemisphere.direction_and_determinant_columns(columns, slopes), rows=50)
    torch.testing.assert_close(found[:, :2], wo.float(), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found[:, 2], det.float(), rtol=1e-3, atol=1e-4)


def test_spline_of_kept_points():
    raw = 2 * torch.randn(3000, 14, generator=rng(26))
    y, x = (torch.empty(3000).uniform_(-1.1, 1.1, generator=rng(k)) for k in (27, 28))
    keep = torch.rand(3000, generator=rng(29)) < 0.5
    columns = columns_of(raw)
    value, found = spline.unwarp_or_keep_columns(
        columns, *(columns_of(v[:, None])[0] for v in (y, x)), llvm.Bool(keep.numpy())
    )
    ours = tensor_of(value, spline.evaluate_columns(found, value)[1], rows=3000)
    at = torch.where(
        keep, x, tensor_of(spline.unwarp_columns(columns, columns_of(y[:, None])[0])[0], rows=3000)
    )
    assert torch.equal(ours[:, 0], at)
    slope = spline.warp(raw.double(), at.double())[1].exp()
    assert ((ours[:, 1] / slope - 1).abs() < 1e-3).float().mean() > 0.99


def test_cells_are_shared():
    """A spline for all values of a row gives what one for each gives."""
    raw, x = torch.randn(6, 1, 14, generator=rng(30)), cells(4)[None, :, 0].expand(6, -1)
    for function in (spline.warp, lambda r, v: (spline.unwarp(r, v),)):
        for one, each in zip(function(raw, x), function(raw.expand(6, 16, 14), x), strict=True):
            assert torch.equal(one, each)
