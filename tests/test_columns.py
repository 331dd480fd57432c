"""Tensors as columns and back, and networks over columns against the same ones in torch."""

from __future__ import annotations

import copy

import drjit as dr
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.core.columns.bridge import Columns, Float, columns_of, tensor_of
from harness.core.columns.method import ColumnMethod
from harness.nets.encoding import ConditionEncoder, sinusoids, sinusoids_columns
from harness.nets.mlp import MLP

each_example = settings(max_examples=25, deadline=None, derandomize=True, database=None)


def rand(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def through_columns(function, x: Tensor) -> Tensor:
    """``function`` of columns applied to rows [N, C]."""
    return tensor_of(*function(columns_of(x)), rows=len(x))


def net(widths: list[int], activation: str = "relu", seed: int = 0) -> MLP:
    """A network with random weights, biases included."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return MLP(widths, activation).eval()


# --- the bridge ------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 7, 1000])
@pytest.mark.parametrize(
    "layout",
    [
        lambda x: x,
        lambda x: x.T.contiguous().T,
        lambda x: x.repeat_interleave(2, 1)[:, ::2],
        lambda x: x.double(),
        lambda x: x.clone().requires_grad_(),
        lambda x: x[:1].expand(len(x), -1),
    ],
    ids=["rows", "columns", "strided", "double", "grad", "expanded"],
)
def test_there_and_back(n, layout):
    """Whatever the layout in memory, and without a trace of autograd."""
    x = layout(rand(n, 3))
    columns = columns_of(x)
    assert [dr.width(c) for c in columns] == [n] * 3
    back = tensor_of(*columns, rows=n)
    assert back.shape == (n, 3) and back.dtype == torch.float32 and not back.requires_grad
    assert torch.equal(back, x.detach().float())
    assert torch.equal(tensor_of(columns[1], rows=n), x.detach().float()[:, 1])


@pytest.mark.parametrize("width", [1, 3])
def test_result_is_the_callers(width):
    """Writing to it reaches neither the input nor the columns."""
    x = rand(50, width)
    before, columns = x.clone(), columns_of(x)
    back = tensor_of(*columns, rows=50)
    back.fill_(7)
    assert torch.equal(x, before)
    assert torch.equal(tensor_of(*columns, rows=50).view(50, width), before)


def test_columns_outlive_their_tensor():
    """Memory that is shared is kept."""
    columns = columns_of(rand(4000, 1))
    for _ in range(20):
        torch.full((4000, 1), 5.0)
    assert torch.equal(tensor_of(*columns, rows=4000), rand(4000, 1)[:, 0])


def test_constant_columns_fill_all_rows():
    """A column of width one stands for all rows, and is no view of a single number."""
    one = type(columns_of(rand(1, 1))[0])(0.25)
    alone = tensor_of(one, rows=5)
    assert alone.tolist() == [0.25] * 5
    alone[0] = 1
    assert alone.tolist() == [1, 0.25, 0.25, 0.25, 0.25]
    beside = tensor_of(one, columns_of(rand(5, 1))[0], rows=5)
    assert beside.shape == (5, 2) and (beside[:, 0] == 0.25).all()


class Echo(ColumnMethod):
    """Hands its inputs straight through; a density that is constant."""

    name = "echo"

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        return c[0], u[1], type(u[0])(0.5)

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        return wo[0]


@pytest.mark.parametrize("n", [0, 1, 33])
def test_column_method(n):
    """The protocol's tensors in and out; an output that is an input is a copy of it."""
    method, c, u = Echo(), rand(n, 2), rand(n, 3, seed=1)
    before = c.clone(), u.clone()
    wo, pdf = method.sample(c, u)
    assert wo.shape == (n, 2) and pdf.shape == (n,)
    assert torch.equal(wo, torch.stack([c[:, 0], u[:, 1]], -1)) and (pdf == 0.5).all()
    density = method.pdf(c, wo)
    assert density.shape == (n,) and torch.equal(density, wo[:, 0])
    with torch.inference_mode():
        for result in (wo, pdf, density):
            result.fill_(9)
    assert torch.equal(c, before[0]) and torch.equal(u, before[1])


# --- networks --------------------------------------------------------------------------


@st.composite
def networks(draw) -> tuple[MLP, Tensor]:
    """A network of any small shape, and rows for it."""
    widths = draw(st.lists(st.integers(1, 20), min_size=2, max_size=4))
    activation = draw(st.sampled_from(["relu", "leaky_relu"]))
    seed, rows = draw(st.integers(0, 999)), draw(st.sampled_from([1, 2, 17, 300]))
    return net(widths, activation, seed), 3 * rand(rows, widths[0], seed=seed)


@settings(each_example, max_examples=12)
@given(networks())
def test_network_over_columns(drawn):
    """Cooperative vectors and written-out multiply-adds both give what torch gives."""
    mlp, x = drawn
    with torch.no_grad():
        expected = mlp(x)
    # Sums of at most 20 products of size one, in another order.
    close = {"rtol": 1e-5, "atol": 1e-5}
    torch.testing.assert_close(through_columns(mlp.columns, x).view_as(expected), expected, **close)
    looped = through_columns(mlp._columns_looped, x).view_as(expected)
    torch.testing.assert_close(looped, expected, **close)


def test_constant_input_column():
    """An input of width one is that number in all rows."""
    mlp, x = net([3, 16, 2]), rand(9, 3)
    x[:, 1] = 0.5
    columns = columns_of(x)
    columns[1] = type(columns[0])(0.5)
    with torch.no_grad():
        expected = mlp(x)
    for run in (mlp.columns, mlp._columns_looped):
        torch.testing.assert_close(tensor_of(*run(columns), rows=9), expected, rtol=1e-5, atol=1e-6)


def test_nan_stays_in_its_row():
    """And is not swallowed by the activation."""
    mlp, x = net([3, 16, 2]), rand(9, 3)
    x[4, 1] = torch.nan
    for run in (mlp.columns, mlp._columns_looped):
        out = through_columns(run, x)
        assert out[torch.arange(9) != 4].isfinite().all()
        assert out[4].isnan().all()


def step(mlp: MLP, optimiser: type[torch.optim.Optimizer], **options: bool) -> None:
    """One step of an optimiser."""
    mlp(torch.ones(1, 3)).sum().backward()
    optimiser(mlp.parameters(), 0.1, **options).step()


def one_number(mlp: MLP) -> None:
    """Write to one entry of one bias."""
    with torch.no_grad():
        mlp.layers[1].bias[0] += 1


CHANGES = {
    "load_state_dict": lambda mlp: mlp.load_state_dict(net([3, 16, 2], seed=1).state_dict()),
    "sgd": lambda mlp: step(mlp, torch.optim.SGD),
    # Does not count in torch's version counters.
    "fused-adam": lambda mlp: step(mlp, torch.optim.Adam, fused=True),
    "one-number": one_number,
    "new-tensor": lambda mlp: setattr(mlp.layers[0].weight, "data", rand(16, 3, seed=2)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_packed_weights_follow_the_parameters(change):
    """The packed copy is made again when a parameter changes, and only then."""
    mlp, x = net([3, 16, 2]), rand(9, 3)
    before = through_columns(mlp.columns, x)
    packed = mlp._forms._made
    assert torch.equal(through_columns(mlp.columns, x), before)
    assert mlp._forms._made is packed
    CHANGES[change](mlp)
    with torch.no_grad():
        expected = mlp(x)
    assert not torch.allclose(expected, before, atol=1e-3)
    torch.testing.assert_close(through_columns(mlp.columns, x), expected, rtol=1e-5, atol=1e-6)


def test_copies_are_independent():
    """A deep copy packs its own weights."""
    mlp, x = net([3, 16, 2]), rand(9, 3)
    before = through_columns(mlp.columns, x)
    clone = copy.deepcopy(mlp)
    one_number(clone)
    assert torch.equal(through_columns(mlp.columns, x), before)
    assert (through_columns(clone.columns, x) - before)[:, 0].allclose(torch.ones(9), atol=1e-5)


def test_zero_last():
    """A network that starts at zero, whatever it sees."""
    mlp = MLP([3, 8, 2], zero_last=True)
    assert (through_columns(mlp.columns, rand(5, 3)) == 0).all()


# --- encodings -------------------------------------------------------------------------


def test_sinusoids():
    """The numbers themselves, then sines and cosines, frequency by frequency."""
    x = rand(4, 2)
    parts = [x, x.sin(), x.cos(), (2 * x).sin(), (2 * x).cos()]
    assert torch.equal(sinusoids(x, 2), torch.cat(parts, -1))
    assert torch.equal(sinusoids(x, 0), x)


@each_example
@given(st.integers(1, 3), st.integers(0, 6), st.integers(0, 99))
def test_sinusoids_over_columns(width, frequencies, seed):
    """In the same order. The double-angle formulas may double a rounding error a step."""
    x = torch.tanh(rand(33, width, seed=seed))
    found = through_columns(lambda c: sinusoids_columns(c, frequencies), x).view(33, -1)
    torch.testing.assert_close(found, sinusoids(x, frequencies), rtol=0, atol=2e-7 * 2**frequencies)


@pytest.mark.parametrize(("n_address", "n_features"), [(0, 0), (2, 0), (0, 3), (2, 8)])
def test_condition_encoder(n_address, n_features):
    """Both ways agree; the address is not seen; features are standardised."""
    encoder = ConditionEncoder(n_address, n_features)
    condition = 3 + 2 * rand(500, n_address + n_features + 2)
    condition[:, -2:] = torch.tanh(condition[:, -2:])
    encoder.standardise(condition)
    out = encoder(condition)
    assert out.shape == (500, encoder.width) and encoder.width == n_features + 22
    torch.testing.assert_close(
        through_columns(encoder.columns, condition), out, rtol=1e-5, atol=2e-5
    )
    torch.testing.assert_close(out[:, n_features : n_features + 2], condition[:, -2:])
    if n_features:
        features = out[:, :n_features]
        torch.testing.assert_close(features.mean(0), torch.zeros(n_features), rtol=0, atol=1e-5)
        torch.testing.assert_close(
            features.std(0, correction=0), torch.ones(n_features), rtol=1e-5, atol=0
        )
    moved = condition.clone()
    moved[:, :n_address] += 100
    assert torch.equal(encoder(moved), out)
    assert torch.equal(
        through_columns(encoder.columns, moved), through_columns(encoder.columns, condition)
    )


def test_encoder_state():
    """Mean and scale are part of what is stored."""
    encoder, other = ConditionEncoder(0, 2), ConditionEncoder(0, 2)
    condition = 5 * rand(100, 4)
    encoder.standardise(condition)
    other.load_state_dict(encoder.state_dict())
    assert torch.equal(encoder(condition), other(condition))


def test_feature_that_never_varies():
    """Is finite, and zero where it is what it always was."""
    encoder = ConditionEncoder(0, 1)
    condition = torch.cat([torch.full((10, 1), 0.5), torch.zeros(10, 2)], 1)
    encoder.standardise(condition)
    assert (encoder(condition)[:, 0] == 0).all()
    assert np.isfinite(through_columns(encoder.columns, condition).numpy()).all()
