"""Flow matching: the discrete map, its inverse and its density; fits; what is refused."""

from __future__ import annotations

import functools
import math
from collections import Counter
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.func import jacfwd, vmap

from harness._methods.flow_matching import FlowMatching
from harness.core import registry
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol import counting
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError, StateRefused
from harness.core.protocol.method import Budget
from harness.fitting.flow_matching import in_rows
from harness.nets import discrete_flow_columns, discrete_flow_inverse, domains
from harness.nets.activations import ACTIVATIONS
from harness.nets.discrete_flow import DiscreteFlow, determinant
from harness.nets.encoding import Encoded
from harness.nets.mixture_base import BASES, MixtureBase
from harness.nets.solvers import SOLVERS
from harness.nets.velocity import Velocity
from harness.stats.chisquare import sidak
from tests.disk import compare
from tests.materials import MATERIALS

BUDGET = Budget(steps=60, conditions=64, directions=32, resolution=32, pool=256)
SMALL = {"width": 16, "layers": 2}
FEW = {**SMALL, "base": "gaussian", "domain": "plane", "training": "likelihood", "reflow": 0}
ENCODED = 5


def field(activation: str = "silu", size: float = 0.2, seed: int = 0) -> Velocity:
    """A velocity that bends: its last layer is not zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = Velocity(ENCODED, 16, 2, activation).requires_grad_(False)
        torch.nn.init.normal_(net.layers[-1].weight, std=size)
    return net


def drawn(n: int, seed: int = 1) -> tuple[Tensor, Tensor]:
    """Encoded conditions [n, E] and places [n, 1, 2]."""
    g = torch.Generator().manual_seed(seed)
    return torch.randn(n, ENCODED, generator=g), torch.randn(n, 1, 2, generator=g)


@functools.cache
def fitted(kind: str = "tilted", steps: int = 2, budget_steps: int = 60, **params) -> FlowMatching:
    method = registry.make("flow-matching", steps=steps, **params)
    budget = replace(BUDGET, steps=budget_steps)
    method.fit(MATERIALS[kind](), budget, torch.Generator().manual_seed(0))
    return method


# --- the discrete map ----------------------------------------------------------------------------


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_derivatives_are_those_of_the_velocity(activation):
    net, (encoded, x) = field(activation).double(), drawn(50)
    encoded, x = encoded.double(), x.double()
    shared = net.shared(encoded)
    unit = torch.eye(2, dtype=x.dtype)[:, None, None].expand(2, *x.shape)
    value, *along = net.push(torch.cat([x[None], unit]), 0.3, shared)
    torch.testing.assert_close(value, net(x, 0.3, shared))
    expected = vmap(jacfwd(lambda p, s: net(p[None, None], 0.3, s[None])[0, 0]))(x[:, 0], shared)
    torch.testing.assert_close(torch.stack(along, -1)[:, 0], expected)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_map_and_its_inverse(solver):
    """In doubles: back to where it came from, with the determinant of the whole map."""
    flow = DiscreteFlow(field().double(), 3, solver)
    encoded, x = (v.double() for v in drawn(200))
    shared = flow.velocity.shared(encoded)
    moved = flow.forward(x, shared)
    origin = flow.invert(moved.x, shared)
    assert bool(origin.found.all()) and float(moved.least.min()) > 0
    torch.testing.assert_close(origin.x, x, rtol=0, atol=1e-10)
    torch.testing.assert_close(origin.log_det, moved.log_det, rtol=0, atol=1e-9)
    torch.testing.assert_close(determinant(moved.jacobian).log(), moved.log_det)
    jacobian = vmap(jacfwd(lambda p, s: flow.endpoint(p[None, None], s[None])[0, 0]))
    torch.testing.assert_close(
        torch.linalg.slogdet(jacobian(x[:, 0], shared))[1], moved.log_det[:, 0]
    )
    torch.testing.assert_close(flow.endpoint(x, shared), moved.x)


def test_steps_back_are_no_inverse_and_come_closer_with_their_number():
    """The published pdf's error falls in proportion to the step, and does not vanish."""
    encoded, x = (v.double() for v in drawn(200))
    net, errors = field().double(), []
    for steps in (4, 8, 16):
        flow = DiscreteFlow(net, steps)
        shared = net.shared(encoded)
        moved = flow.forward(x, shared)
        errors.append(float((flow.backward(moved.x, shared).log_det - moved.log_det).abs().mean()))
    assert errors[0] > 1e-4
    assert 1.7 < errors[0] / errors[1] < 2.3 and 1.7 < errors[1] / errors[2] < 2.3


@pytest.mark.parametrize(("solver", "steps"), [("euler", 3), ("midpoint", 1)])
def test_columns_take_the_same_steps(solver, steps):
    flow = DiscreteFlow(field(), steps, solver)
    encoded, x = drawn(500)
    shared = flow.velocity.shared(encoded)
    columns = flow.velocity.shared_columns(Encoded.plain(columns_of(encoded)))
    expected, back = flow.forward(x, shared), flow.backward(x, shared)
    moved = discrete_flow_columns.forward(flow, columns_of(x[:, 0]), columns)
    origin = discrete_flow_inverse.invert(flow, moved.x, columns)
    other = discrete_flow_columns.backward(flow, columns_of(x[:, 0]), columns)
    got = tensor_of(*moved.x, moved.det, *origin.x, origin.det, *other.x, other.det, rows=500)
    torch.testing.assert_close(got[:, :2], expected.x[:, 0], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(got[:, 2].log(), expected.log_det[:, 0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(got[:, 3:5], x[:, 0], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(got[:, 5], got[:, 2], rtol=1e-4, atol=0)
    torch.testing.assert_close(got[:, 6:8], back.x[:, 0], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(got[:, 8].log(), back.log_det[:, 0], rtol=1e-4, atol=1e-5)


def test_what_is_not_inverted_is_counted_and_is_no_number():
    """Of a velocity so steep that its step folds many times, Newton's method loses its way."""
    method = registry.make("flow-matching", **{**FEW, "steps": 1})
    method.bind(MATERIALS["plain"]())
    g = torch.Generator().manual_seed(3)
    with torch.no_grad():
        method.module.velocity.layers[-1].weight.normal_(0, 30, generator=g)
    condition = method.material.conditions(500, g)
    with counting.into(Counter()) as counts:
        pdf = method.pdf(condition, square_to_disk(torch.rand(500, 2, generator=g)))
    missed = int(pdf.isnan().sum())
    assert 0 < missed == counts["not inverted"]


def test_gradients_of_the_inverse():
    """Of the density by a weight, against central differences in doubles."""
    net = field().double()
    flow = DiscreteFlow(net, 2)
    encoded, x = (v.double() for v in drawn(40))
    weight = net.layers[1].weight

    def value() -> Tensor:
        shared = net.shared(encoded)
        origin = flow.origin(x, shared, rounds=20)
        return (origin.log_det + origin.x.square().sum(-1)).sum()

    weight.requires_grad_(True)
    (slope,) = torch.autograd.grad(value(), weight)
    weight.requires_grad_(False)
    step = 1e-5
    for i, j in ((0, 0), (3, 7)):
        kept = weight[i, j].clone()
        weight[i, j] = kept + step
        above = value()
        weight[i, j] = kept - step
        below = value()
        weight[i, j] = kept
        assert float((above - below) / (2 * step)) == pytest.approx(float(slope[i, j]), rel=1e-4)


# --- domains and bases ---------------------------------------------------------------------------


@pytest.mark.parametrize("domain", domains.DOMAINS)
def test_domains_there_and_back(domain):
    wo = square_to_disk(torch.rand(400, 2, generator=torch.Generator().manual_seed(0)))
    wo = torch.cat([wo * 0.999, wo[:8] * 1e-3, torch.zeros(1, 2)]).double()
    place, log_slope = domains.from_disk(domain, wo)
    torch.testing.assert_close(domains.to_disk(domain, place), wo, rtol=0, atol=1e-9)
    jacobian = vmap(jacfwd(lambda p: domains.from_disk(domain, p)[0]))(wo[:-1])
    torch.testing.assert_close(torch.linalg.slogdet(jacobian)[1], log_slope[:-1], rtol=0, atol=1e-6)
    at, slope = domains.from_disk_columns(domain, columns_of(wo))
    got = tensor_of(*at, slope, *domains.to_disk_columns(domain, at), rows=len(wo)).double()
    torch.testing.assert_close(got[:, :2], place, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(got[:, 2].log(), log_slope, rtol=1e-4, atol=2e-4)
    torch.testing.assert_close(got[:, 3:], wo, rtol=0, atol=1e-6)


def test_the_uniform_disk_is_the_standard_normal_of_the_plane():
    wo = square_to_disk(torch.rand(200, 2, generator=torch.Generator().manual_seed(0))).double()
    place, log_slope = domains.from_disk("plane", wo)
    log_normal = -0.5 * place.square().sum(-1) - math.log(2 * math.pi)
    expected = torch.full_like(log_slope, -math.log(math.pi))
    torch.testing.assert_close(log_normal + log_slope, expected, rtol=0, atol=1e-9)
    off, slope = domains.from_disk("plane", torch.tensor([[1.0, 0.0], [0.8, 0.7]]))
    assert (off == 0).all() and (slope == -math.inf).all()


@pytest.mark.parametrize("kind", BASES)
@pytest.mark.parametrize("own_share", [False, True])
def test_bases_integrate_to_one_and_columns_agree(kind, own_share):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        base = MixtureBase(kind, ENCODED, 8, 0.1, own_share).requires_grad_(False)
        if base.net is not None:
            torch.nn.init.normal_(base.net.layers[-1].weight, std=0.3)
    encoded = drawn(3)[0]
    axis = torch.linspace(-8, 8, 321)
    grid = torch.cartesian_prod(axis, axis)
    density = base(encoded).log_prob(grid.expand(3, -1, -1)).exp()
    torch.testing.assert_close(density.sum(1) * 0.05**2, torch.ones(3), rtol=0, atol=1e-3)
    rows = encoded.repeat_interleave(len(grid), 0)
    columns = base.columns(Encoded.plain(columns_of(rows))).pdf(columns_of(grid.repeat(3, 1)))
    got = tensor_of(columns, rows=3 * len(grid)).view(3, -1)
    torch.testing.assert_close(got, density, rtol=1e-4, atol=1e-7)


def test_pairs_are_a_permutation_and_nearer():
    g = torch.Generator().manual_seed(0)
    a, b = torch.randn(50, 16, 2, generator=g), torch.randn(50, 16, 2, generator=g) + 0.5
    one, other = in_rows(a), in_rows(b)
    torch.testing.assert_close(one.sort(1).values, a.sort(1).values)
    assert float((one - other).square().mean()) < 0.5 * float((a - b).square().mean())


# --- the method ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "params",
    [
        pytest.param({**SMALL, "steps": 50}, marks=pytest.mark.slow),
        {**FEW, "steps": 1},
        {**FEW, "steps": 1, "base": "lobes", "domain": "square", "lambertian": True},
    ],
    ids=["published-50", "plane-1", "square-lobes"],
)
def test_samples_follow_the_density(params):
    """Chi-square at the paper's fifty steps and at one; sample's pdf is pdf, to 1e-4."""
    method = fitted(**params)
    material = method.material
    row = material.conditions(1, torch.Generator().manual_seed(1))[0]
    n = 1 << 14
    test, integral, valid = compare(method, row, n, torch.Generator().manual_seed(2))
    assert abs(integral - valid) < 1e-3 + 5 * math.sqrt(valid * (1 - valid) / n)
    assert test.p_value > sidak(1e-3, 3)
    g = torch.Generator().manual_seed(3)
    condition, u = material.conditions(1 << 14, g), torch.rand(1 << 14, 3, generator=g)
    wo, pdf = method.sample(condition, u)
    apart = (method.pdf(condition, wo) - pdf).abs() > 1e-4 * pdf
    assert float(apart.double().mean()) <= 1e-4
    twin = method.in_torch().sample(condition[:512], u[:512])
    torch.testing.assert_close(twin.wo, wo[:512], rtol=0, atol=2e-5)
    near = (twin.pdf - pdf[:512]).abs() <= 1e-3 * pdf[:512]
    assert float(near.double().mean()) > 0.99


def test_at_the_rim_a_sample_has_the_density_of_a_query(monkeypatch):
    """Where the rounding of a direction moves its place in the plane, and with it a determinant."""
    method = fitted(**FEW)
    g = torch.Generator().manual_seed(4)
    u = torch.rand(4000, 3, generator=g)
    u[:, 0] = 1 - torch.exp2(-8 - 16 * u[:, 0])
    condition = MATERIALS["tilted"]().conditions(4000, g)

    def off() -> Tensor:
        wo, pdf = method.sample(condition, u)
        asked = method.pdf(condition, wo)
        there = asked > 0
        return ((pdf - asked).abs() / asked)[there]

    assert (off() > 1e-4).double().mean() <= 1e-3
    monkeypatch.setattr("harness.nets.flow_sampling.FELT", torch.inf)
    assert (off() > 1e-4).double().mean() > 1e-2


def test_a_direction_of_the_uniform_share_without_origin_has_no_density(monkeypatch):
    method = fitted(**{**FEW, "domain": "disk"}, uniform=0.25)
    g = torch.Generator().manual_seed(4)
    condition, u = MATERIALS["tilted"]().conditions(4000, g), torch.rand(4000, 3, generator=g)
    uniform = u[:, 2] < 0.25
    assert 0 < int(uniform.sum()) < 4000
    before = method.sample(condition, u).pdf
    assert bool(before.isfinite().all())
    found = discrete_flow_inverse.invert

    def lost(*given):
        origin = found(*given)
        nowhere = origin.det != origin.det
        return discrete_flow_columns.ColumnOrigin(origin.x, origin.det, nowhere)

    monkeypatch.setattr("harness.nets.discrete_flow_inverse.invert", lost)
    after = method.sample(condition, u).pdf
    assert torch.equal(after.isnan(), uniform)
    assert torch.equal(after[~uniform], before[~uniform])


def test_the_published_pdf_is_another_and_is_declared_so():
    """Its integral is not one; of the same state, with the same samples."""
    exact = fitted(**{**FEW, "steps": 4})
    params = {**FEW, "steps": 4}
    other = registry.make("flow-matching-published", **params)
    other.bind(exact.material)
    other.load_state_dict(exact.state_dict())
    assert exact.exact_pdf and not other.exact_pdf
    g = torch.Generator().manual_seed(0)
    condition, u = exact.material.conditions(2048, g), torch.rand(2048, 3, generator=g)
    wo, pdf = exact.sample(condition, u)
    theirs = other.sample_weighted(condition, u)
    torch.testing.assert_close(theirs.wo, wo, rtol=0, atol=1e-5)
    torch.testing.assert_close(theirs.pdf, other.pdf(condition, wo), rtol=1e-3, atol=0)
    assert float(((theirs.pdf - pdf).abs() / pdf).median()) > 1e-4
    query = registry.make("flow-matching-published-query", **params)
    query.bind(exact.material)
    query.load_state_dict(exact.state_dict())
    torch.testing.assert_close(query.sample(condition, u).pdf, pdf)
    torch.testing.assert_close(query.pdf(condition, wo), other.pdf(condition, wo))


def test_phases_share_the_budget():
    method = registry.make("flow-matching", **SMALL, reflow=2)
    report = method.fit(
        MATERIALS["plain"](), replace(BUDGET, steps=31), torch.Generator().manual_seed(0)
    )
    assert method.phases() == ["matching", "reflow", "reflow"]
    assert report.steps == 31 and report.optimise_seconds > 0 and "reflow" in report.notes


def test_reflow_straightens():
    """Steps of the rectified flow lead nearer to where many lead than those of the first."""
    bends = []
    for reflow in (0, 1):
        method = fitted("plain", 10, 240, **SMALL, reflow=reflow, pairing=False)
        net, g = method.module, torch.Generator().manual_seed(0)
        with torch.no_grad():
            at = net.at(method.material.conditions(512, g))
            x0 = net.draw(at.base, 1, g)
            ends = [DiscreteFlow(net.velocity, s).endpoint(x0, at.shared) for s in (2, 50)]
        bends.append(float((ends[0] - ends[1]).square().sum(-1).mean()))
    assert bends[1] < 0.5 * bends[0]


def test_a_state_runs_with_another_number_of_steps_and_is_another_sampler():
    method = fitted(**FEW)
    other = registry.make("flow-matching", **{**FEW, "steps": 3})
    other.bind(method.material)
    other.load_state_dict(method.state_dict())
    g = torch.Generator().manual_seed(0)
    condition, u = method.material.conditions(256, g), torch.rand(256, 3, generator=g)
    assert not torch.equal(other.sample(condition, u).wo, method.sample(condition, u).wo)


# --- bad input -----------------------------------------------------------------------------------


def test_a_step_that_folds_is_refused():
    method = fitted(**{**FEW, "steps": 1})
    state = method.state_dict()
    last = f"velocity.layers.{SMALL['layers']}.weight"
    state[last] = state[last] + 5 * torch.randn(
        state[last].shape, generator=torch.Generator().manual_seed(0)
    )
    other = registry.make("flow-matching", **{**FEW, "steps": 1})
    other.bind(method.material)
    with pytest.raises(StateRefused, match="not one to one") as refused:
        other.load_state_dict(state)
    assert 0 < refused.value.number <= 1 and "\n" not in str(refused.value)


def test_a_velocity_that_is_no_number_is_refused():
    method = fitted(**{**FEW, "steps": 1})
    state = method.state_dict()
    state["velocity.layers.0.weight"] = state["velocity.layers.0.weight"] * math.nan
    other = registry.make("flow-matching", **{**FEW, "steps": 1})
    other.bind(method.material)
    with pytest.raises(StateRefused, match="not finite"):
        other.load_state_dict(state)


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"steps": 0}, "at least one of steps"),
        ({"reflow": -1}, "no negative reflow"),
        ({"base": "gausian"}, "base is 'gausian'; did you mean 'gaussian'"),
        ({"domain": "sphere"}, "domain is 'sphere'"),
        ({"solver": "heun"}, "solver is 'heun'"),
        ({"activation": "gelu"}, "activation is 'gelu'"),
        ({"training": "both"}, "training is 'both'"),
        ({"uniform": 1.0}, "uniform is 1.0"),
    ],
)
def test_bad_parameters(params, said):
    with pytest.raises(InputError, match=said) as refused:
        FlowMatching(**params)
    assert "\n" not in str(refused.value)
