"""The normalizing flows: splines, couplings, and the two methods made of them."""

from __future__ import annotations

import math

import drjit as dr
import pytest
import torch
from scipy.stats import chi2

from harness._methods.neural_spline_flow import NeuralSplineFlow
from harness._methods.realnvp import RealNVP
from harness.core.columns.bridge import columns_of
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError, StateRefused
from harness.core.protocol.method import Budget
from harness.fitting.steady import STEADY, UNIT
from harness.nets import spline
from harness.nets.extremes import FAR
from tests.flow_inputs import BELOW_ONE, Plain, inputs

METHODS = {
    "spline-disk": lambda: NeuralSplineFlow(),
    "spline-square": lambda: NeuralSplineFlow(domain="square"),
    "spline-plain": lambda: NeuralSplineFlow(uniform=0),
    "spline-square-lambertian": lambda: NeuralSplineFlow(domain="square", lambertian=True),
    "spline-small": lambda: NeuralSplineFlow(width=16, bins=5, frequencies=2),
    "realnvp": lambda: RealNVP(),
    "realnvp-plain": lambda: RealNVP(uniform=0),
    "realnvp-trainable": lambda: RealNVP(base="trainable"),
}


def make(kind: str, scale: float = 1.0, seed: int = 0):
    """A flow with random weights, its last layers' of the size ``scale``."""
    method = METHODS[kind]()
    torch.manual_seed(seed)
    method.bind(Plain())
    with torch.no_grad():
        for name, p in method.module.named_parameters():
            if p.abs().max() < 1 and ("layers.2" in name or "base" in name):
                size = 0.5 if "spline" in kind and "base" not in name else 0.15
                p.add_(torch.randn_like(p) * scale * size)
    return method


@pytest.fixture(params=METHODS)
def kind(request):
    return request.param


@pytest.mark.parametrize("scale", [0.0, 0.3, 1.0])
def test_sample_pdf_is_pdf_of_the_sample(kind, scale):
    method = make(kind, scale)
    condition, u = inputs(20000)
    wo, pdf = method.sample(condition, u)
    again = method.pdf(condition, wo)
    assert torch.isfinite(wo).all() and torch.isfinite(pdf).all()
    assert ((again - pdf).abs() <= 1e-4 * pdf).all()
    if method.uniform:
        # The share that makes every weight finite.
        assert (pdf[inside_disk(wo)] >= 0.999 * method.uniform / math.pi).all()


def test_uniform_share(kind):
    """It is where the third uniform says, and of the size it says."""
    if kind == "spline-square-lambertian":
        pytest.skip("its share is not the same in all conditions; see the next test")
    method = make(kind, 0.5)
    condition, u = inputs(4000)
    u[:, 2] = 0.999 * method.uniform
    if method.uniform:
        wo = method.sample(condition, u).wo
        torch.testing.assert_close(wo.square().sum(-1), u[:, 0], rtol=1e-4, atol=1e-5)
    plain = make(kind, 0.5)
    plain.uniform = 0
    u[:, 2] = method.uniform
    torch.testing.assert_close(method.sample(condition, u).wo, plain.sample(condition, u).wo)
    points = torch.rand(4000, 2) * 2.2 - 1.1
    mixed = (1 - method.uniform) * plain.pdf(condition, points)
    mixed += method.uniform / math.pi * inside_disk(points)
    torch.testing.assert_close(method.pdf(condition, points), mixed, rtol=1e-5, atol=1e-7)


def test_a_share_of_its_own_in_every_condition():
    """The Lambertian's share is the base network's, and it is where the third uniform says."""
    method = make("spline-square-lambertian", 1.0)
    condition, u = inputs(4000)
    with torch.no_grad():
        raw = method.module.base(method.module.encoder(condition))[:, 4]
    share = 0.01 + 0.99 * torch.sigmoid(raw)
    assert share.std() > 0.01
    for side, uniform in ((0.999, True), (1.001, False)):
        u[:, 2] = side * share
        wo = method.sample(condition, u).wo
        same = (wo.square().sum(-1) - u[:, 0]).abs() < 1e-4
        assert same.all() if uniform else same.float().mean() < 0.01
    plain = make("spline-square-lambertian", 1.0)
    plain.lambertian, plain.uniform = False, 0
    points = torch.rand(4000, 2) * 2.2 - 1.1
    mixed = (1 - share) * plain.pdf(condition, points) + share / math.pi * inside_disk(points)
    torch.testing.assert_close(method.pdf(condition, points), mixed, rtol=1e-5, atol=1e-7)


def test_a_share_out_of_range():
    with pytest.raises(InputError, match="uniform"):
        RealNVP(uniform=1.0)
    with pytest.raises(InputError, match="uniform"):
        NeuralSplineFlow(uniform=-0.1)


@pytest.mark.parametrize("scale", [0.0, 0.3, 1.0])
def test_twins_agree(kind, scale):
    method = make(kind, scale)
    condition, u = inputs(20000)
    wo, pdf = method.sample(condition, u)
    method.module.double()
    with torch.no_grad():
        torch64 = method.log_prob(condition.double(), wo[:, None].double())[:, 0]
    error = (pdf.double().log() - torch64).abs()
    assert error.quantile(0.999) < 1e-4 and error.max() < 2e-3


def test_log_prob_is_the_base_times_the_jacobian(kind):
    """The whole map's Jacobian by autograd, its determinant against the density."""
    method = make(kind, 0.5)
    method.uniform, method.lambertian = 0, False
    net = method.module.double()
    condition = inputs(8)[0].double()
    encoded = net.encoder(condition)
    wo = torch.empty(8, 2, dtype=torch.float64).uniform_(-0.6, 0.6)

    def density_of(v):
        x, y = v[:, None].unbind(-1)
        if "square" in kind:
            x = x / (1 - y * y).sqrt()
        if "spline" in kind:
            x = spline.warp(net.x_given_y(y, encoded), x)[0]
            y = spline.warp(net.y_given_x(x, encoded), y)[0]
        else:
            for net_, order in ((net.x_given_y, 0), (net.y_given_x, 1)):
                given = (y, x)[order]
                raw, shift = net_(given, encoded).unbind(-1)
                moved = (x, y)[order] * (10 * torch.tanh(raw / 10)).exp() + shift
                x, y = (moved, y) if order == 0 else (x, moved)
        return torch.cat([x, y], -1)

    full = torch.autograd.functional.jacobian(density_of, wo)
    index = torch.arange(8)
    log_det = torch.linalg.slogdet(full[index, :, index]).logabsdet
    z = density_of(wo)
    if "spline" in kind:
        mean, raw = net.base(encoded)[..., :4].chunk(2, -1)
    else:
        mean, raw = net.mean, net.raw_sigma
    normal = torch.distributions.Normal(mean, (10 * torch.tanh(raw / 10)).exp())
    expected = normal.log_prob(z).sum(-1) + log_det
    torch.testing.assert_close(method.log_prob(condition, wo[:, None])[:, 0], expected)


def test_samples_follow_the_density(kind):
    """Chi-square over a grid of the square around the disk, plus everything beyond it."""
    method = make(kind, 0.6, seed=2)
    n, bins, fine = 400_000, 24, 32
    one = inputs(1, seed=5)[0]
    u = torch.rand(n, 3, generator=torch.Generator().manual_seed(9))
    wo = method.sample(one.expand(n, -1), u).wo
    cell = ((wo + 1) * (bins / 2)).floor().long()
    within = ((cell >= 0) & (cell < bins)).all(-1)
    flat = cell[within, 0] * bins + cell[within, 1]
    observed = torch.bincount(flat, minlength=bins * bins).double()
    side = (torch.arange(bins * fine, dtype=torch.float64) + 0.5) / (bins * fine) * 2 - 1
    points = torch.cartesian_prod(side, side).float()
    pdf = method.pdf(one.expand(len(points), -1), points).double()
    mass = pdf.view(bins, fine, bins, fine).sum((1, 3)).flatten() * (2 / (bins * fine)) ** 2
    expected = mass * n
    observed = torch.cat([observed, torch.tensor([float(n - within.sum())])])
    expected = torch.cat([expected, (n - expected.sum()).clamp(min=1e-3)[None]])
    # Pool by expected count, never by the observed one, so that a missing lobe shows.
    order = expected.argsort()
    small = expected[order].cumsum(0) < 20
    pooled = [(expected[order][small].sum(), observed[order][small].sum())]
    pooled += list(zip(expected[order][~small], observed[order][~small], strict=True))
    pooled = [(float(e), float(o)) for e, o in pooled if e > 5]
    statistic = sum((o - e) ** 2 / e for e, o in pooled)
    assert chi2.sf(statistic, len(pooled) - 1) > 1e-4


def test_integral_over_the_disk_is_the_share_of_valid_samples(kind):
    from harness.fitting.targets import cells

    method = make(kind, 0.3)
    one = inputs(1)[0]
    points = cells(512)
    integral = method.pdf(one.expand(len(points), -1), points).mean() * math.pi
    u = torch.rand(200_000, 3, generator=torch.Generator().manual_seed(1))
    valid = inside_disk(method.sample(one.expand(len(u), -1), u).wo).float().mean()
    assert abs(integral - valid) < 5e-3


def test_corners_of_the_uniforms(kind):
    method = make(kind, 1.0)
    values = torch.tensor([0.0, 2**-24, 0.5, BELOW_ONE])
    u = torch.cartesian_prod(values, values, values)
    condition = inputs(len(u))[0]
    before = condition.clone(), u.clone()
    wo, pdf = method.sample(condition, u)
    assert torch.isfinite(wo).all() and torch.isfinite(pdf).all() and (pdf >= 0).all()
    torch.testing.assert_close(method.pdf(condition, wo), pdf, rtol=1e-4, atol=1e-30)
    assert (condition == before[0]).all() and (u == before[1]).all()


@pytest.mark.parametrize("at", [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [3.0, -7.0]])
def test_density_at_the_rim_and_beyond_is_finite(kind, at):
    method = make(kind, 0.5)
    condition = inputs(64)[0]
    for wo in (torch.tensor(at), torch.tensor(at) * BELOW_ONE):
        pdf = method.pdf(condition, wo.expand(64, 2).contiguous())
        assert torch.isfinite(pdf).all() and (pdf >= 0).all()


def test_none_one_and_nan_rows(kind):
    method = make(kind, 0.5)
    condition, u = inputs(9)
    assert method.sample(condition[:0], u[:0]).wo.shape == (0, 2)
    all_rows = method.sample(condition, u)
    single = method.sample(condition[:1], u[:1])
    torch.testing.assert_close(single.wo, all_rows.wo[:1], rtol=1e-5, atol=1e-6)
    spoiled = condition.clone()
    spoiled[4] = math.nan
    wo, pdf = method.sample(spoiled, u)
    others = torch.arange(9) != 4
    assert (wo[others] == all_rows.wo[others]).all() and torch.isnan(pdf[4])
    assert (pdf[others] == all_rows.pdf[others]).all()


def test_state_round_trip(kind):
    method, fresh = make(kind, 0.7), METHODS[kind]()
    fresh.bind(Plain())
    fresh.load_state_dict(method.state_dict())
    condition, u = inputs(100)
    assert (fresh.sample(condition, u).wo == method.sample(condition, u).wo).all()


def test_from_base_is_the_inverse_of_to_base(kind):
    method = make(kind, 0.5)
    net, condition = method.module.double(), inputs(300)[0].double()
    z = torch.randn(300, 2, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    with torch.no_grad():
        wo = method.from_base(net, condition, z)
        back, _ = method.to_base(net, condition, wo)
    torch.testing.assert_close(back, z, rtol=1e-6, atol=1e-6)
    # And the sampler goes the same way: through it the uniforms come back.
    method.module.float()
    condition, u = inputs(300)
    u[:, 2] = 0.9999
    back = method.inverse(condition, method.sample(condition, u).wo)
    torch.testing.assert_close(back[:, :2].float(), u[:, :2], rtol=0, atol=1e-3)


def sheared(shear: float) -> RealNVP:
    """x' = x e^10, then y' = y + ``shear`` x' where x' > 0: dy' / dx is their product."""
    method = RealNVP(uniform=0)
    method.bind(Plain())
    with torch.no_grad():
        for p in method.module.parameters():
            p.zero_()
        method.module.x_given_y.mlp.layers[-1].bias[0] = FAR
        for layer, row in zip(method.module.y_given_x.mlp.layers, (0, 0, 1), strict=True):
            layer.weight[row, 0] = 1
        method.module.y_given_x.mlp.layers[-1].weight[1, 0] = shear
    return method


@pytest.mark.parametrize(("times", "refused"), [(0.9, False), (1.1, True)])
def test_a_map_too_steep_for_single_precision_is_refused(times, refused):
    """On either side of the slope at which the rounding of x moves y' by ``STEADY``."""
    method = sheared(times * STEADY / UNIT / math.exp(10))
    assert (method.unsteady() > 0) == refused
    fresh, state = RealNVP(uniform=0), method.state_dict()
    fresh.bind(Plain())
    if not refused:
        fresh.load_state_dict(state)
        return
    with pytest.raises(StateRefused, match="realnvp: state refused") as error:
        fresh.load_state_dict(state)
    assert error.value.number == method.unsteady()


def test_ordinary_states_are_steady(kind):
    assert make(kind, 0.5).unsteady() == 0


def test_a_fit_that_ends_in_such_a_state_is_refused():
    class Diverges(RealNVP):
        def unsteady(self):
            return 0.25

    budget = Budget(steps=1, conditions=4, directions=4, resolution=8, pool=4)
    with pytest.raises(StateRefused, match=r"in 25\.00% of the samples"):
        Diverges().fit(Plain(), budget, torch.Generator().manual_seed(0))
    report = RealNVP().fit(Plain(), budget, torch.Generator().manual_seed(0))
    assert report.steps == 1


def test_an_unknown_choice_is_refused():
    with pytest.raises(InputError, match="'disk' or 'square'"):
        NeuralSplineFlow(domain="cube")
    with pytest.raises(InputError, match="'fixed' or 'trainable'"):
        RealNVP(base="none")
    with pytest.raises(InputError, match="bins"):
        NeuralSplineFlow(bins=1)


def test_paper_sizes():
    method = NeuralSplineFlow()
    method.bind(Plain())
    shapes = [tuple(layer.weight.shape) for layer in method.module.x_given_y.mlp.layers]
    assert shapes == [(32, 39), (32, 32), (59, 32)]
    assert [tuple(layer.weight.shape) for layer in method.module.base.layers] == [(32, 30), (4, 32)]
    assert dr.width(columns_of(torch.zeros(3, 1))[0]) == 3
