"""The two histogram methods, and the tables and grids they are made of."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from harness._methods.histogram import Histogram
from harness._methods.histogram_mixture import HistogramMixture
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.fitting.targets import Targets
from harness.nets.alias import AliasTables, split_bins, whole_units
from harness.nets.basis import BasisHistograms, Volume
from harness.nets.squares import Squares

BELOW_ONE = 1 - 2**-24


class Lobe(Material):
    """A lobe about the mirror direction, its width a feature; another feature is idle."""

    name, n_features = "lobe", 2

    def eval(self, condition, wo):
        width = 0.15 + 0.1 * condition[:, 0]
        away = (wo + condition[:, -2:]).square().sum(1)
        value = torch.exp(-0.5 * away / width.square()) + 0.05
        return torch.where(inside_disk(wo), value, 0)[:, None].expand(-1, 3)

    def places(self, uv):
        return uv

    def identity(self):
        return {"name": self.name}


KINDS = {
    "histogram": lambda: Histogram(),
    "histogram-odd": lambda: Histogram(resolution=11),
    "mixture": lambda: HistogramMixture(levels=20),
    "mixture-free": lambda: HistogramMixture(levels=20, rotation="free"),
    "mixture-odd": lambda: HistogramMixture(bases=3, levels=7, resolution=27),
}


def make(kind: str, scale: float = 1.0, seed: int = 0):
    """A method of random weights, those of the last layers ``scale`` times their usual size."""
    method = KINDS[kind]()
    torch.manual_seed(seed)
    method.bind(Lobe())
    with torch.no_grad():
        nets = [m for m in method.module.modules() if hasattr(m, "layers")]
        for net in nets:
            net.layers[-1].weight.mul_(4 * scale)
            net.layers[-1].bias.mul_(4 * scale)
    return method


def inputs(n: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    return Lobe().conditions(n, g), torch.rand(n, 3, generator=g)


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


# Squares


@pytest.mark.parametrize("n", [2, 3, 10, 32, 64])
def test_squares_cover_the_disk_and_no_more(n):
    squares = Squares.covering(n)
    g = torch.Generator().manual_seed(0)
    wo = torch.rand(200000, 2, generator=g) * 2 - 1
    inside = inside_disk(wo)
    cell = ((wo + 1) * (n / 2)).long()
    hit = torch.zeros(n * n, dtype=torch.bool)
    hit[(cell[:, 1] * n + cell[:, 0])[inside]] = True
    kept = torch.zeros(n * n, dtype=torch.bool)
    kept[squares.index] = True
    assert (kept | ~hit).all()
    assert float(squares.share.sum()) * squares.width**2 == pytest.approx(math.pi, rel=4e-3)
    assert (squares.share > 0).all() and (squares.share <= 1).all()
    assert (squares.point.norm(dim=-1) <= 1 + 1e-6).all()
    corner = (squares.index % n, squares.index // n)
    near = sum(((2 * i + 1 - n).abs() / n - 1 / n).clamp(min=0) ** 2 for i in corner)
    assert (near <= 1 + 1e-6).all()


@pytest.mark.parametrize("shift", [0.0, 0.37, 1.0])
def test_tents_integrate_to_the_disk(shift):
    squares = Squares.tents(24, shift)
    assert float(squares.share.sum()) * squares.width**2 == pytest.approx(math.pi, rel=3e-4)
    last = squares.first + squares.width * 23
    assert squares.first <= -1 and last >= 1 - 1e-9


# Alias tables


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(2, 12), st.sampled_from([1.0, 20.0, 300.0]))
def test_alias_bins_hold_exactly_the_masses(seed, n, spread):
    rng = np.random.default_rng(seed)
    mass = torch.tensor(np.exp(rng.normal(size=(5, n * n)) * spread / 10))
    mass[0, rng.integers(0, n * n)] = 0
    mass[1, 1:] = 0
    bits = max(1, (n * n - 1).bit_length())
    capacity = 1 << (32 - bits)
    whole = whole_units(mass, capacity * n * n)
    assert (whole.sum(1) == capacity * n * n).all()
    assert ((whole > 0) == (mass > 0)).all()
    keep, alias = split_bins(whole, capacity)
    # A full bin says capacity - 1 and names itself.
    back = torch.zeros_like(whole).scatter_add_(1, alias, capacity - keep) + keep
    assert (back == whole).all()
    assert (keep >= 0).all() and (keep < capacity).all()


def test_alias_tables_draw_their_density():
    n = 16
    g = torch.Generator().manual_seed(1)
    mass = torch.rand(3, n * n, generator=g) ** 6
    mass[:, :40] = 0
    tables = AliasTables.of(mass, n)
    density = tables.density.view(3, -1)
    torch.testing.assert_close(density.double().sum(1) * (2 / n) ** 2, torch.ones(3).double())
    expected = mass / mass.sum(1, keepdim=True)
    torch.testing.assert_close(density * (2 / n) ** 2, expected, rtol=1e-4, atol=1e-8)
    count = 1_000_000
    u = torch.rand(count, 3, generator=g)
    columns = columns_of(u)
    data = tables.columns(type(columns[0]))
    x, y = tables.sample_columns(data, 2, columns)
    xy = tensor_of(x, y, rows=count)
    assert (xy >= -1).all() and (xy <= 1).all()
    cell = ((xy + 1) * (n / 2)).long().clamp(max=n - 1)
    found = torch.bincount(cell[:, 1] * n + cell[:, 0], minlength=n * n).double()
    _check_counts(found, expected[2].double() * count)


def _check_counts(found: torch.Tensor, expected: torch.Tensor, level: float = 1e-4) -> None:
    assert found[expected == 0].sum() <= 2
    small = expected < 5
    observed = torch.cat([found[~small], found[small].sum()[None]])
    wanted = torch.cat([expected[~small], expected[small].sum()[None]])
    keep = wanted > 1
    statistic = ((observed - wanted).square() / wanted.where(keep, torch.ones(()).double()))[keep]
    assert chi2.sf(float(statistic.sum()), int(keep.sum()) - 1) > level


# Basis and volume


def test_volume_is_the_network_and_integrates_to_one():
    torch.manual_seed(0)
    basis = BasisHistograms(4, 16, 2, uniform=0.01)
    with torch.no_grad():
        basis.mlp.layers[-1].weight.mul_(8)
    g = torch.Generator().manual_seed(0)
    volume = Volume.random(basis, 5, 20, g)
    n = 400
    fine = Squares.covering(n)
    centre = torch.stack([fine.index % n, fine.index // n], -1) * (2 / n) - 1 + 1 / n
    for t in (0.0, 0.43, 1.0):
        at = centre[None, :, None].expand(1, -1, 4, 2)
        value = volume.at(at, torch.full((1, 4), t))[0]
        integral = (value * fine.share[:, None]).sum(0) * fine.width**2
        torch.testing.assert_close(integral, torch.ones(4), rtol=2e-3, atol=0)
    level = volume.first_level + 2 * volume.level_width
    inner = volume.squares.point.norm(dim=-1) < 0.9
    own = basis.density(volume.squares, torch.tensor([level]))[0, inner]
    at = volume.squares.point[inner][None, :, None].expand(1, -1, 4, 2)
    again = volume.at(at, torch.full((1, 4), level))[0]
    torch.testing.assert_close(again, own, rtol=1e-3, atol=1e-4)


def test_log_value_is_log_softplus_wherever_it_lives():
    basis = BasisHistograms(1, 4, 1, uniform=0.01)
    for bias in (-300.0, -20.0, -15.0, 0.0, 40.0):
        with torch.no_grad():
            basis.mlp.layers[-1].weight.zero_()
            basis.mlp.layers[-1].bias.fill_(bias)
        value = basis.log_value(torch.zeros(1, 2), torch.zeros(1))
        expected = math.log(math.log1p(math.exp(bias))) if bias > -30 else bias
        assert float(value.detach()) == pytest.approx(expected, rel=1e-6)
        value.sum().backward()
        assert torch.isfinite(basis.mlp.layers[-1].bias.grad).all()


def test_bake_is_the_network_at_cell_centres():
    method = make("mixture")
    tables, _ = method.tables()
    n = method.resolution
    squares = Squares.covering(n)
    codes = torch.linspace(0, 1, method.levels)
    with torch.no_grad():
        density = method.module.basis.density(squares, codes).permute(0, 2, 1)
    baked = tables.density.view(method.levels, method.bases, -1)
    outside = torch.ones(n * n, dtype=torch.bool)
    outside[squares.index] = False
    assert (baked[..., outside] == 0).all() and (baked[..., squares.index] > 0).all()
    torch.testing.assert_close(
        baked.double().sum(-1) * (2 / n) ** 2, torch.ones(baked.shape[:2]).double()
    )
    wanted = density * squares.share.sqrt()
    wanted = wanted / (wanted.sum(-1, keepdim=True) * squares.width**2)
    torch.testing.assert_close(baked[..., squares.index], wanted, rtol=2e-4, atol=1e-6)


# Methods


@pytest.mark.parametrize("scale", [0.0, 1.0, 6.0])
def test_sample_pdf_is_pdf_of_the_sample(kind, scale):
    method = make(kind, scale)
    condition, u = inputs(20000)
    before = condition.clone(), u.clone()
    wo, pdf = method.sample(condition, u)
    again = method.pdf(condition, wo)
    assert torch.isfinite(wo).all() and torch.isfinite(pdf).all()
    assert (pdf[inside_disk(wo)] > 0).all()
    assert ((again - pdf).abs() <= 1e-4 * pdf).all()
    assert torch.equal(before[0], condition) and torch.equal(before[1], u)


def test_integral_over_the_square_is_one_and_over_the_disk_the_valid_share(kind):
    method = make(kind)
    n = 700
    centre = (torch.arange(n) + 0.5) * (2.84 / n) - 1.42
    y, x = torch.meshgrid(centre, centre, indexing="ij")
    wo = torch.stack([x, y], -1).view(-1, 2)
    for row in inputs(3, 5)[0]:
        pdf = method.pdf(row.expand(len(wo), -1), wo) * (2.84 / n) ** 2
        assert float(pdf.sum()) == pytest.approx(1, abs=4e-3)
        u = inputs(100000, 6)[1]
        valid = inside_disk(method.sample(row.expand(len(u), -1), u).wo).float().mean()
        assert float(pdf[inside_disk(wo)].sum()) == pytest.approx(float(valid), abs=4e-3)


def test_positive_all_over_the_disk(kind):
    method = make(kind, 30.0)
    condition, u = inputs(20000, 3)
    r = (u[:, 0].sqrt() * BELOW_ONE)[:, None]
    wo = r * torch.stack([torch.cos(7 * u[:, 1]), torch.sin(7 * u[:, 1])], -1)
    wo[:4] = torch.tensor([[BELOW_ONE, 0], [-BELOW_ONE, 0], [0, BELOW_ONE], [0, -BELOW_ONE]])
    assert (method.pdf(condition, wo) > 0).all()


def test_chi_square(kind):
    method = make(kind)
    row = inputs(1, 8)[0]
    count, bins, sub = 400000, 24, 24
    u = inputs(count, 9)[1]
    wo = method.sample(row.expand(count, -1), u).wo
    edge = 1.42
    cell = ((wo + edge) * (bins / (2 * edge))).long()
    found = torch.bincount(cell[:, 1] * bins + cell[:, 0], minlength=bins**2).double()
    centre = (torch.arange(bins * sub) + 0.5) * (2 * edge / bins / sub) - edge
    y, x = torch.meshgrid(centre, centre, indexing="ij")
    at = torch.stack([x, y], -1).view(-1, 2)
    pdf = method.pdf(row.expand(len(at), -1), at).double().view(bins, sub, bins, sub)
    expected = pdf.sum((1, 3)).flatten() * (2 * edge / bins / sub) ** 2 * count
    # The bins' integrals are sums over points of a function with steps: good to a percent.
    loose = (found - expected).abs() <= 6 * expected.sqrt() + 0.02 * expected + 3
    assert loose.all()


@pytest.mark.parametrize("corner", [0.0, BELOW_ONE])
def test_uniforms_at_their_edges(kind, corner):
    method = make(kind)
    condition, u = inputs(600, 2)
    for i in range(3):
        v = u.clone()
        v[:, i] = corner
        wo, pdf = method.sample(condition, v)
        assert torch.isfinite(wo).all() and torch.isfinite(pdf).all()
        assert (pdf[inside_disk(wo)] > 0).all()
    wo, pdf = method.sample(condition, torch.full_like(u, corner))
    assert torch.isfinite(wo).all() and torch.isfinite(pdf).all()


def test_no_rows_one_row_and_a_bad_row(kind):
    method = make(kind)
    condition, u = inputs(300, 4)
    for n in (0, 1):
        wo, pdf = method.sample(condition[:n], u[:n])
        assert wo.shape == (n, 2) and pdf.shape == (n,)
        assert method.pdf(condition[:n], wo).shape == (n,)
    wo, pdf = method.sample(condition, u)
    bad = condition.clone()
    bad[7, 0] = math.nan
    again = method.sample(bad, u)
    others = torch.arange(300) != 7
    torch.testing.assert_close(again.wo[others], wo[others])
    torch.testing.assert_close(again.pdf[others], pdf[others])
    if kind.startswith("histogram"):
        # Over columns, the network's ReLU is a maximum, which drops a nan.
        assert torch.isnan(again.pdf[7])
    far = torch.tensor([[2.0, 0.0], [1.5, 1.5], [3e38, -3e38], [math.inf, 0.0]])
    assert (method.pdf(condition[:4], far) == 0).all()


def test_log_prob_is_pdf_in_torch():
    method = make("histogram")
    condition, u = inputs(2000)
    wo, pdf = method.sample(condition, u)
    with torch.no_grad():
        other = method.log_prob(condition, wo[:, None])[:, 0]
    torch.testing.assert_close(other, pdf.log(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("kind", ["mixture", "mixture-free", "mixture-odd"])
def test_columns_agree_with_equation_5_in_torch(kind):
    """The torch gates and a lookup in torch, against the kernel."""
    method = make(kind)
    condition, u = inputs(4000, 1)
    wo = (u[:, :2] * 2 - 1) * 0.7
    c, s = method.module.gates(condition).rotation.detach().unbind(-1)
    torch.testing.assert_close(c * c + s * s, torch.ones_like(c))
    pdf = method.log_prob(condition, wo[:, None])[:, 0].exp()
    error = (method.pdf(condition, wo) / pdf - 1).abs()
    # A point or a code in the last bit of its cell may be found in the next.
    assert error.quantile(0.995) < 1e-4


def test_a_turned_scene_turns_the_azimuth_mixture():
    """With gates that do not see wi, rotating wi and wo together changes nothing."""
    method = make("mixture")
    with torch.no_grad():
        method.module.gate.mlp.layers[0].weight[:, -2:] = 0
    condition, u = inputs(4000, 2)
    wo = (u[:, :2] * 2 - 1) * 0.7
    c, s = math.cos(0.9), math.sin(0.9)
    turn = torch.tensor([[c, s], [-s, c]])
    turned = condition.clone()
    turned[:, -2:] = condition[:, -2:] @ turn
    error = (method.pdf(turned, wo @ turn) / method.pdf(condition, wo) - 1).abs()
    assert error.quantile(0.99) < 1e-3


def test_normal_incidence_and_vanishing_directions_are_handled():
    method = make("mixture")
    condition, u = inputs(6, 2)
    condition[:, -2:] = torch.tensor([[0, 0], [1e-30, 0], [0, -1e-42], [1, 0], [0, 0], [0, 1e-20]])
    wo, pdf = method.sample(condition, u)
    assert torch.isfinite(wo).all() and (pdf > 0).all()
    with torch.no_grad():
        for p in method.module.gate.parameters():
            p.zero_()
    method.module.zero_grad()
    wo, pdf = method.sample(condition, u)
    assert torch.isfinite(wo).all() and (pdf > 0).all()
    gates = method.module.gates(condition)
    (gates.rotation.sum() + gates.code.sum()).backward()
    grads = [p.grad for p in method.module.gate.parameters()]
    assert all(torch.isfinite(g).all() for g in grads)


@pytest.mark.parametrize("loss", ["mse", "kl"])
@pytest.mark.parametrize("name", ["histogram", "mixture"])
def test_fit_learns_and_state_is_the_networks_alone(name, loss):
    material = Lobe()
    budget = Budget(steps=60, conditions=64, directions=64, resolution=32, pool=256)

    def new():
        kind = Histogram if name == "histogram" else functools.partial(HistogramMixture, levels=20)
        return kind(loss=loss)

    method = new()
    report = method.fit(material, budget, torch.Generator().manual_seed(0))
    assert np.mean(report.loss[-10:]) < np.mean(report.loss[:5])
    assert method.size_bytes() < 300_000
    other = new()
    other.bind(material)
    other.load_state_dict(method.state_dict())
    condition, u = inputs(500)
    for a, b in zip(method.sample(condition, u), other.sample(condition, u), strict=True):
        assert torch.equal(a, b)


def test_mixed_draws_have_the_expectation_of_uniform_ones():
    material = Lobe()
    budget = Budget(resolution=16, pool=4)
    targets = Targets.build(material, budget, torch.Generator().manual_seed(0))
    g = torch.Generator().manual_seed(1)
    condition, _, density, weight = targets.mixed(64, 4001, g)
    assert float(weight.mean()) == pytest.approx(1, abs=5e-3)
    assert float((weight * density).mean()) * math.pi == pytest.approx(1, abs=1e-2)
    assert weight.max() <= 4001 / 2000


@pytest.mark.parametrize(
    "make_it",
    [
        lambda: Histogram(loss="l1"),
        lambda: Histogram(resolution=1),
        lambda: HistogramMixture(loss="mae"),
        lambda: HistogramMixture(rotation="wi"),
        lambda: HistogramMixture(levels=1),
        lambda: HistogramMixture(resolution=400),
        lambda: HistogramMixture(uniform=0.0),
    ],
)
def test_refused(make_it):
    with pytest.raises(InputError):
        make_it()


def test_one_condition_many_times_is_any_other_batch():
    """The network runs once for it; a row of another condition, or of nan, makes it run for all."""
    method = make("histogram", 0.5)
    condition, u = inputs(300)
    same = condition[:1].expand(300, -1).clone()
    mixed, broken = same.clone(), same.clone()
    mixed[7], broken[7] = condition[7], torch.nan
    runs = []
    method.module.net.register_forward_hook(lambda net, rows, out: runs.append(len(out)))
    alone = method.sample(same, u)
    among, beside = method.sample(mixed, u), method.sample(broken, u)
    assert runs == [1, 300, 300]
    others = torch.arange(300) != 7
    for drawn in (among, beside):
        torch.testing.assert_close(drawn.wo[others], alone.wo[others], rtol=0, atol=1e-4)
        torch.testing.assert_close(drawn.pdf[others], alone.pdf[others])
    torch.testing.assert_close(method.pdf(same, among.wo)[others], among.pdf[others])
    assert method.sample(same[:0], u[:0]).wo.shape == (0, 2)
