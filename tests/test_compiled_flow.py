"""A flow's steps by the compiled kernels: agreement with torch in double, and with Dr.Jit."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.compiled import build, history, library
from harness.nets import discrete_flow_columns, discrete_flow_inverse
from harness.nets.activations import ACTIVATIONS
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.encoding import Encoded, Group
from harness.nets.velocity import Shared, Velocity

each_example = settings(max_examples=25, deadline=None, derandomize=True, database=None)
pytestmark = pytest.mark.skipif(
    build.compiler() is None or isinstance(library.found(), str), reason="no compiled kernels here"
)
ENCODED = 5


def flow_of(
    width: int = 24,
    layers: int = 3,
    steps: int = 4,
    activation: str = "silu",
    seed: int = 0,
    solver: str = "euler",
    **options,
) -> DiscreteFlow:
    """Of a velocity that bends, gently enough for its steps to be one to one."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = Velocity(ENCODED, width, layers, activation, **options).requires_grad_(False)
        for layer in net.layers:
            torch.nn.init.normal_(layer.bias, std=0.2)
        torch.nn.init.normal_(net.layers[-1].weight, std=0.3 / width**0.5)
    return DiscreteFlow(net, steps, solver)


def drawn(n: int, seed: int = 1) -> tuple[Tensor, Tensor]:
    """Encoded conditions [n, E] and places [n, 2]."""
    g = torch.Generator().manual_seed(seed)
    return torch.randn(n, ENCODED, generator=g), 2 * torch.randn(n, 2, generator=g)


def shared_of(flow: DiscreteFlow, encoded: Tensor) -> Shared:
    return flow.velocity.shared_columns(Encoded.plain(columns_of(encoded)))


def all_ways(flow: DiscreteFlow, encoded: Tensor, x: Tensor) -> dict[str, Tensor]:
    """What each way gives, by columns; the inverse begins at ``x`` too."""
    shared, at, n = shared_of(flow, encoded), columns_of(x), len(x)
    moved = discrete_flow_columns.forward(flow, at, shared)
    end = discrete_flow_columns.endpoint(flow, at, shared)
    back = discrete_flow_columns.backward(flow, at, shared)
    origin = discrete_flow_inverse.invert(flow, at, shared)
    found = dr.select(origin.found, type(at[0])(1), 0)
    return {
        "forward": tensor_of(*moved.x, moved.det, *moved.jacobian, rows=n),
        "endpoint": tensor_of(*end, rows=n),
        "backward": tensor_of(*back.x, back.det, rows=n),
        "inverse": tensor_of(*origin.x, origin.det, found, rows=n),
    }


def by_torch(flow: DiscreteFlow, encoded: Tensor, x: Tensor) -> dict[str, Tensor]:
    """The same in double."""
    net = flow.velocity.double()
    flow = DiscreteFlow(net, flow.steps, flow.solver)
    shared, at = net.shared(encoded.double()), x.double()[:, None]
    moved, back, origin = (f(at, shared) for f in (flow.forward, flow.backward, flow.invert))
    whole = moved.jacobian[:, :, 0].movedim(0, 1).reshape(-1, 4)

    def row(x: Tensor, log_det: Tensor) -> Tensor:
        return torch.cat([x[:, 0], log_det.exp()], 1)

    found = {
        "forward": torch.cat([row(moved.x, moved.log_det), whole], 1),
        "endpoint": flow.endpoint(at, shared)[:, 0],
        "backward": row(back.x, back.log_det),
        "inverse": torch.cat([row(origin.x, origin.log_det), origin.found.double()], 1),
    }
    net.float()
    return found


@given(
    width=st.integers(1, 70),
    layers=st.integers(1, 4),
    steps=st.integers(1, 7),
    rows=st.integers(1, 500),
    activation=st.sampled_from(ACTIVATIONS),
    bounded=st.booleans(),
    seed=st.integers(0, 99),
)
@each_example
def test_any_flow_is_torchs(width, layers, steps, rows, activation, bounded, seed):
    flow = flow_of(width, layers, steps, activation, seed, bounded=bounded)
    encoded, x = drawn(rows, seed)
    with history.recorded() as runs:
        found = all_ways(flow, encoded, x)
    wanted = by_torch(flow, encoded, x)
    assert [run.rows for run in runs] == [rows] * 4
    for way, expected in wanted.items():
        scale = 1 + expected[:, :2].abs().amax(1)
        assert ((found[way][:, :2] - expected[:, :2]).abs().amax(1) < 1e-5 * scale).all(), way
        if way != "endpoint":
            torch.testing.assert_close(
                found[way][:, 2].double(), expected[:, 2], rtol=1e-5, atol=0, msg=way
            )
    torch.testing.assert_close(found["forward"].double(), wanted["forward"], rtol=1e-5, atol=2e-5)
    assert (found["inverse"][:, 3] == 1).all() and (wanted["inverse"][:, 3] == 1).all()


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_back_to_where_it_came_from(steps):
    """The density of a sample and of a query there, at the width and depth of the paper's."""
    flow, (encoded, x) = flow_of(64, 5, steps), drawn(3000)
    shared = shared_of(flow, encoded)
    moved = discrete_flow_columns.forward(flow, columns_of(x), shared)
    origin = discrete_flow_inverse.invert(flow, moved.x, shared)
    got = tensor_of(*origin.x, origin.det / moved.det, rows=len(x))
    assert dr.all(origin.found)
    torch.testing.assert_close(got[:, :2], x, rtol=0, atol=2e-5)
    torch.testing.assert_close(got[:, 2], torch.ones(len(x)), rtol=0, atol=1e-5)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_without_compiled_kernels_it_is_the_same(activation, switched):
    """Where steps fold, too: what is found by one is found by the other."""
    flow, (encoded, x) = flow_of(activation=activation), drawn(700)
    found = all_ways(flow, encoded, x)
    switched("off")
    for way, expected in all_ways(flow, encoded, x).items():
        torch.testing.assert_close(found[way], expected, rtol=2e-5, atol=2e-5, msg=way)


def test_what_has_no_origin_is_not_found():
    """One step that takes the plane to a line: nothing ends off it."""
    flow, (encoded, x) = flow_of(2, 1, 1, "relu", bounded=False), drawn(300)
    first, last = flow.velocity.layers
    for layer in (first, last):
        layer.weight.zero_()
        layer.bias.zero_()
    # u_y = -y, by the rectified y and -y.
    first.weight[:, 1] = torch.tensor([1.0, -1.0])
    last.weight[1] = torch.tensor([-1.0, 1.0])
    found = all_ways(flow, encoded, x)
    assert (found["endpoint"][:, 1] == 0).all()
    assert (found["inverse"][:, 3] == 0).all()


def test_rows_do_not_know_their_neighbours():
    """Bit for bit the same alone, in a batch, and in any order: sums of a row are its own."""
    flow, (encoded, x) = flow_of(20, 2, 5), drawn(400)
    whole = all_ways(flow, encoded, x)
    for rows in (slice(0, 1), slice(7, 230), torch.randperm(400)):
        part = all_ways(flow, encoded[rows], x[rows])
        for way, expected in whole.items():
            assert torch.equal(part[way], expected[rows]), way


def test_rows_that_are_not_active_stay():
    flow, (encoded, x) = flow_of(), drawn(500)
    shared, at = shared_of(flow, encoded), columns_of(x)
    index = dr.arange(dr.uint32_array_t(type(at[0])), 500)
    active = (index % 7 == 3) | ((index > 200) & (index < 210))
    moved = discrete_flow_columns.forward(flow, at, shared, active)
    origin = discrete_flow_inverse.invert(flow, at, shared, active)
    got = tensor_of(*moved.x, moved.det, *origin.x, origin.det, rows=500)
    whole, chosen = all_ways(flow, encoded, x), torch.from_numpy(active.numpy())
    expected = torch.cat([whole["forward"][:, :3], whole["inverse"][:, :3]], 1)
    assert torch.equal(got[chosen], expected[chosen])
    still = torch.cat([x, torch.ones(500, 1)], 1)
    assert torch.equal(got[~chosen], torch.cat([still, still], 1)[~chosen])
    assert dr.all(origin.found | ~active)


def test_a_nan_stays_in_its_row():
    flow, (encoded, x) = flow_of(), drawn(200)
    clean = all_ways(flow, encoded, x)
    encoded[5, 2], x[77, 1] = torch.nan, torch.nan
    found = all_ways(flow, encoded, x)
    bad = torch.zeros(200, dtype=torch.bool)
    bad[[5, 77]] = True
    for way, expected in clean.items():
        assert torch.equal(found[way][~bad], expected[~bad]), way
        assert found[way][bad].isnan().any(1).all() or way == "inverse"
    assert (found["inverse"][bad, 3] == 0).all()


def test_encoded_columns_and_columns_of_one_value():
    """The kernel encodes; a column of one value is the same in all rows."""
    flow, (encoded, x) = flow_of(), drawn(130)
    flow.velocity.layers[0].weight[:, 3:] *= 2
    c = columns_of(encoded[:, :2])
    array = type(c[0])
    groups = (Group([c[0]], None, [0.3], [2.0]), Group([c[1]], 1), Group([array(0.5)]))
    shared = flow.velocity.shared_columns(Encoded(groups))
    moved = discrete_flow_columns.forward(flow, columns_of(x), shared)
    a, b = encoded[:, :1], encoded[:, 1:2]
    rows = torch.cat([(a - 0.3) * 2, b, b.sin(), b.cos(), torch.full_like(a, 0.5)], 1)
    expected = by_torch(flow, rows, x)["forward"][:, :3].float()
    torch.testing.assert_close(
        tensor_of(*moved.x, moved.det, rows=130), expected, rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("what", ["midpoint", "waves", "loop"])
def test_what_the_kernels_cannot_run_is_dr_jits(what):
    flow = flow_of(
        solver="midpoint" if what == "midpoint" else "euler", waves=2 if what == "waves" else 0
    )
    encoded, x = drawn(40)
    shared, at = shared_of(flow, encoded), columns_of(x)
    index = dr.uint32_array_t(type(at[0]))

    def body(i, total):
        return i + 1, total + discrete_flow_columns.forward(flow, at, shared).det

    with history.recorded() as runs:
        if what == "loop":
            start = index(0), dr.zeros(type(at[0]), 40)
            det = dr.while_loop(start, lambda i, total: i < 1, body, mode="symbolic")[1]
        else:
            det = discrete_flow_columns.forward(flow, at, shared).det
        got = tensor_of(det, rows=40)
    assert not runs
    expected = by_torch(flow, encoded, x)["forward"][:, 2].float()
    torch.testing.assert_close(got, expected, rtol=1e-5, atol=0)


def test_weights_that_change_are_packed_again():
    flow, (encoded, x) = flow_of(), drawn(50)
    before = all_ways(flow, encoded, x)["endpoint"]
    flow.velocity.layers[1].bias += 0.1
    after = all_ways(flow, encoded, x)["endpoint"]
    assert not torch.equal(before, after)
    expected = by_torch(flow, encoded, x)["endpoint"].float()
    torch.testing.assert_close(after, expected, rtol=1e-5, atol=1e-5)


def test_logistic_function_and_hyperbolic_tangent():
    v = np.concatenate([np.linspace(-100, 100, 3000), np.geomspace(1e-12, 1, 1064)])
    v = np.concatenate([v, [-np.inf, np.inf]]).astype(np.float32)
    v = np.resize(v, 4096)
    wide = v.astype(np.float64)
    *_, logistics, tangents = library.found().elementary(v)
    with np.errstate(over="ignore"):
        np.testing.assert_allclose(logistics, 1 / (1 + np.exp(-wide)), rtol=4e-7, atol=2e-38)
    np.testing.assert_allclose(tangents, np.tanh(wide), rtol=4e-7, atol=0)
    *_, logistics, tangents = library.found().elementary(np.full(64, np.nan, np.float32))
    assert np.isnan(logistics).all() and np.isnan(tangents).all()
