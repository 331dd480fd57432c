"""Compiled kernels: agreement with torch, choice of instruction set, and what happens without."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.core import machine
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.compiled import build, history, instruction_sets, library
from harness.core.compiled.transpose import transposed
from harness.core.protocol.errors import InputError
from harness.nets import compiled_flow, spline
from harness.nets.activations import ACTIVATIONS
from harness.nets.compiled_network import MOST, MOST_BINS, MOST_ROWS, usable
from harness.nets.coupling import CouplingNet
from harness.nets.encoding import ConditionEncoder, Encoded
from harness.nets.mlp import MLP
from harness.nets.spline_couplings import SplineCouplings
from harness.nets.velocity import Velocity

each_example = settings(max_examples=25, deadline=None, derandomize=True, database=None)
HERE = instruction_sets.available()
needs_compiler = pytest.mark.skipif(
    build.compiler() is None or isinstance(library.found(), str), reason="no compiled kernels here"
)


def rand(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def net(widths: list[int], activation: str, seed: int = 0) -> MLP:
    """A network with random weights, biases included."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return MLP(widths, activation).eval()


def encoder(seed: int = 0) -> ConditionEncoder:
    """Of two addresses, three features and a direction."""
    made = ConditionEncoder(2, 3, 5)
    made.standardise(5 + 3 * rand(64, 7, seed=seed))
    return made


# --- agreement -------------------------------------------------------------------------------


@needs_compiler
@given(
    widths=st.lists(st.integers(1, 70), min_size=2, max_size=5),
    rows=st.integers(1, 2000),
    activation=st.sampled_from(ACTIVATIONS),
    seed=st.integers(0, 99),
)
@each_example
def test_any_network_is_torchs(widths, rows, activation, seed):
    x, network = rand(rows, widths[0], seed=seed), net(widths, activation, seed)
    with history.recorded() as runs:
        found = tensor_of(*network.columns(columns_of(x)), rows=rows).reshape(rows, -1)
    with torch.no_grad():
        wanted = network.double()(x.double())
    assert [run.rows for run in runs] == [rows]
    scale = 1 + wanted.abs().max()
    assert (found - wanted).abs().max() < 1e-5 * scale


@needs_compiler
@given(rows=st.integers(1, 300), size=st.sampled_from([1e-6, 1.0, 30.0, 1e4]))
@each_example
def test_encoding_is_torchs(rows, size):
    """Sines of large arguments too: what is multiplied by 16 before a sine has its rounding."""
    part, c = encoder(), size * rand(rows, 7)
    network = net([part.width, 16, 4], "relu")
    found = tensor_of(*network.columns(part.encoded(columns_of(c))), rows=rows)
    with torch.no_grad():
        # The double-angle formulas know the rounded argument, so it is that one's sines.
        wanted = network.double()(part.double()(c.double()))
    assert (found - wanted).abs().max() < 1e-5 * (1 + wanted.abs().max())


@needs_compiler
def test_the_same_bits_as_cooperative_vectors(switched):
    """Both add up in the same order: what kernel ran cannot be seen in a piecewise linear one."""
    network, x = net([30, 32, 32, 5], "leaky_relu"), rand(1000, 30)
    found = tensor_of(*network.columns(columns_of(x)), rows=1000)
    switched("off")
    assert usable(Encoded.plain(columns_of(x)), widths=network.widths) is None
    assert torch.equal(tensor_of(*network.columns(columns_of(x)), rows=1000), found)


@needs_compiler
@pytest.mark.parametrize("target", HERE, ids=lambda s: s.name)
def test_every_instruction_set_of_this_processor_gives_the_same_bits(target, switched):
    network, x = net([30, 32, 32, 5], "silu"), rand(777, 30)
    found = tensor_of(*network.columns(columns_of(x)), rows=777)
    switched(target.name)
    assert library.name() == target.name
    assert torch.equal(tensor_of(*network.columns(columns_of(x)), rows=777), found)


@needs_compiler
def test_wider_registers_than_this_processors_give_the_same_bits(tmp_path, monkeypatch):
    """The code for 16 floats a register, on a processor that may take two registers for it."""
    base = HERE[0]
    options = [o for o in base.options if not o.startswith("-D")]
    target = instruction_sets.InstructionSet(
        "wide", base.machines, base.needs, (*options, "-DWIDTH=16", "-DPACKETS=4", "-DOUTPUTS=4")
    )
    usual = library.found()
    # Half the time to compile.
    monkeypatch.setattr(build, "OPTIONS", tuple(o.replace("-O3", "-O2") for o in build.OPTIONS))
    other = library.opened(build.library(target, tmp_path), target.name, 0.0)
    network, x = net([9, 33, 7], "silu"), Encoded.plain(columns_of(rand(500, 9)))
    found = tensor_of(*network.compiled(usual)(x), rows=500)
    assert torch.equal(tensor_of(*network.compiled(other)(x), rows=500), found)
    velocity = Velocity(9, 20, 2).requires_grad_(False)
    torch.nn.init.normal_(velocity.layers[-1].weight, std=0.1)
    at = columns_of(rand(500, 2, seed=1))
    for way in (compiled_flow.FORWARD, compiled_flow.ENDPOINT, compiled_flow.INVERSE):
        one, two = (velocity.compiled(made).run(way, 4, x, at) for made in (usual, other))
        assert torch.equal(tensor_of(*one, rows=500), tensor_of(*two, rows=500)), way
    couplings, part = spline_couplings(7)
    c = part.encoded(columns_of(rand(500, 7)))
    one, two = (couplings._compiled(made).draw(c, at, at[0] > 1, at) for made in (usual, other))
    assert torch.equal(tensor_of(*one, rows=500), tensor_of(*two, rows=500))


@needs_compiler
def test_exponential_sine_and_cosine():
    made = library.found()
    v = np.concatenate([np.linspace(-110, 95, 4000), [-np.inf, np.inf, 0.0, -0.0]])
    v = np.resize(v.astype(np.float32), 4096)
    e, *_ = made.elementary(v)
    with np.errstate(over="ignore"):
        wanted = np.exp(v.astype(np.float64)).astype(np.float32)
    np.testing.assert_allclose(e, wanted, rtol=4e-7, atol=2e-45)
    assert np.isnan(made.elementary(np.full(64, np.nan, np.float32))[0]).all()
    angle = np.concatenate([np.linspace(-9, 9, 2048), np.geomspace(1, 2**24, 2048)])
    angle = angle.astype(np.float32)
    _, s, c, *_ = made.elementary(angle)
    np.testing.assert_allclose(s, np.sin(angle.astype(np.float64)), rtol=0, atol=1.5e-7)
    np.testing.assert_allclose(c, np.cos(angle.astype(np.float64)), rtol=0, atol=1.5e-7)


# --- special numbers and sizes ---------------------------------------------------------------


@needs_compiler
def test_a_nan_stays_in_its_row_and_infinity_is_torchs():
    network, x = net([3, 8, 2], "relu"), rand(200, 3)
    x[5, 1], x[77, 0] = torch.nan, torch.inf
    found = tensor_of(*network.columns(columns_of(x)), rows=200)
    with torch.no_grad():
        wanted = network(x)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5, equal_nan=True)
    assert torch.isnan(found[5]).all() and not torch.isnan(found[4]).any()


@needs_compiler
def test_columns_of_one_value_and_literals():
    network, x = net([3, 8, 2], "relu"), rand(100, 3)
    columns = columns_of(x)
    array = type(columns[0])
    literal = array(0.5)
    found = tensor_of(*network.columns([columns[0], literal, dr.full(array, 2, 100)]), rows=100)
    same = torch.stack([x[:, 0], torch.full((100,), 0.5), torch.full((100,), 2.0)], 1)
    with torch.no_grad():
        torch.testing.assert_close(found, network(same), rtol=1e-5, atol=1e-6)
    assert literal.state == dr.VarState.Literal, "what the caller holds is as it was"


@needs_compiler
def test_no_kernel_where_columns_have_no_values_or_derivatives_are_wanted():
    network = net([2, 4, 1], "relu")
    columns = columns_of(rand(50, 2))
    array = type(columns[0])
    at = [array(v) for v in columns]
    dr.enable_grad(at)
    with history.recorded() as runs:
        dr.backward(network.columns(at)[0])

        def body(i, total):
            return i + 1, total + network.columns(columns)[0]

        index = dr.uint32_array_t(array)
        _, total = dr.while_loop(
            (index(0), dr.zeros(array, 50)), lambda i, total: i < 2, body, mode="symbolic"
        )
        dr.eval(total)
    assert not runs
    assert dr.any(dr.grad(at[0]) != 0)


@needs_compiler
def test_a_network_too_wide_for_the_kernel_is_dr_jits():
    columns = columns_of(rand(20, 3))
    for widths, there in (((3, MOST, 1), True), ((3, MOST + 1, 1), False)):
        assert (usable(Encoded.plain(columns), widths=widths) is not None) is there
    assert usable(Encoded.plain(columns), widths=(3, 8, 2), bins=MOST_BINS + 1) is None
    many = [dr.full(type(columns[0]), 1, MOST_ROWS + 1)] * 3
    assert usable(Encoded.plain(many), widths=(3, 8, 2)) is None


@pytest.mark.parametrize("rows", [1, 2, 15, 16, 17, 4097])
@pytest.mark.parametrize("name", ["auto", "off"])
def test_transpose(rows, name, switched):
    switched(name)
    x = rand(rows, 9)
    for view in (x, x[:, 2:5], x[::2], x[:, ::3], x.T.contiguous().T):
        assert torch.equal(transposed(view), view.T)
        assert transposed(view).is_contiguous()


# --- splines ---------------------------------------------------------------------------------


def spline_couplings(
    bins: int, couplings: int = 2, square: bool = False, seed: int = 0, size: float = 0.5
) -> tuple[SplineCouplings, ConditionEncoder]:
    """With weights that make steep splines."""
    part = encoder()
    nets = [CouplingNet(part.width, 16, spline.outputs(bins)) for _ in range(couplings)]
    generator = torch.Generator().manual_seed(seed)
    for net in nets:
        for parameter in net.parameters():
            torch.nn.init.normal_(parameter, std=size, generator=generator)
    return SplineCouplings(nets, bins, square), part


@needs_compiler
@given(
    bins=st.integers(2, 40),
    rows=st.integers(1, 400),
    seed=st.integers(0, 99),
    size=st.sampled_from([0.1, 0.5, 2.0]),
)
@each_example
def test_a_spline_is_torchs(bins, rows, seed, size):
    made, part = spline_couplings(bins, 1, seed=seed, size=size)
    c, other, at = rand(rows, 7, seed=seed), rand(rows, 1, seed=seed + 1), rand(rows, 1, seed=2)
    columns = columns_of(torch.cat([c, other, at], 1))
    seen, (o, x) = part.encoded(columns[:7]), columns[7:]
    y, _, slope = made.to_base_columns([x, o], seen)
    drawn, _ = made.draw_columns([y, o], seen, type(y)(0) > 1, [x, o])
    found = tensor_of(y, slope, drawn[0], rows=rows)
    with torch.no_grad():
        raw = made.couplings[0].double()(other.double(), part.double()(c.double()))
        wanted, log_slope = spline.warp(raw, at.double())
    wanted, wanted_slope = wanted[:, 0], log_slope[:, 0].exp()
    # The outputs' own rounding, which steep splines magnify.
    noise = 1e-5 * (1 + raw.abs().amax((1, 2)))
    assert ((found[:, 0] - wanted).abs() < noise * (1 + wanted_slope)).all()
    assert ((found[:, 2] - at[:, 0]).abs() * wanted_slope.clamp(max=1) < noise).all()
    outside = at[:, 0].abs() >= 1
    assert (found[outside, 1] == 1).all() and torch.equal(found[outside, 0], at[outside, 0])


@needs_compiler
@pytest.mark.parametrize("couplings", [1, 2, 3])
@pytest.mark.parametrize("square", [False, True])
def test_a_drawn_places_density_is_that_of_a_query_bit_for_bit(couplings, square):
    """Rows of a block that is not full too."""
    made, part = spline_couplings(20, couplings, square)
    c = columns_of(torch.cat([rand(5003, 7), rand(5003, 2, seed=3) / 2], 1))
    seen, at = part.encoded(c[:7]), c[7:]
    array = type(at[0])
    keep = dr.arange(dr.uint32_array_t(array), 5003) % 3 == 0
    kept = [dr.sin(at[0]), dr.cos(3 * at[1])]
    wo, back = made.draw_columns(at, seen, keep, kept)
    again = made.to_base_columns(wo, seen)
    for one, other in zip(back, again, strict=True):
        assert dr.all(one == other)
    for place, wanted in zip(wo, kept, strict=True):
        assert dr.all(~keep | (place == wanted))
    assert not dr.any(~keep & (dr.abs(at[0]) < 0.9) & (wo[0] == at[0]))


@needs_compiler
@pytest.mark.parametrize("couplings", [1, 2, 3])
@pytest.mark.parametrize("square", [False, True])
def test_couplings_without_compiled_kernels_are_the_same(couplings, square, switched):
    made, part = spline_couplings(20, couplings, square, size=0.1)
    c = columns_of(torch.cat([rand(1000, 7), rand(1000, 2, seed=3).clamp(-0.99, 0.99)], 1))
    seen, at = part.encoded(c[:7]), c[7:]

    def all_of_it() -> Tensor:
        wo, back = made.draw_columns(at, seen, at[0] > 0.5, at)
        return tensor_of(*wo, *back, *made.to_base_columns(at, seen), rows=1000)

    found = all_of_it()
    switched("off")
    torch.testing.assert_close(found, all_of_it(), rtol=1e-4, atol=1e-5)


# --- without -----------------------------------------------------------------------------------


def test_off_is_said(switched):
    switched("off")
    assert library.name() == library.FALLBACK
    assert machine.kernels() == "Dr.Jit; no compiled kernels: switched off by HARNESS_KERNELS=off"


def test_an_unknown_name_is_refused(switched):
    switched("avx3")
    with pytest.raises(InputError, match="HARNESS_KERNELS is 'avx3'.*did you mean 'avx2'"):
        library.found()


def test_an_instruction_set_that_is_not_there_is_refused(switched, monkeypatch):
    monkeypatch.setattr(instruction_sets, "flags", lambda: frozenset({"sse2"}))
    switched("avx512")
    with pytest.raises(InputError, match="is 'avx512', which this processor lacks"):
        library.found()


def test_an_old_processor_has_the_fallback(switched, monkeypatch):
    monkeypatch.setattr(instruction_sets, "flags", lambda: frozenset({"sse2"}))
    monkeypatch.setattr(instruction_sets.platform, "machine", lambda: "x86_64")
    switched("auto")
    assert library.why_not() == "this processor (x86_64) has not avx512 or avx2"
    x = rand(100, 3)
    network = net([3, 8, 2], "relu")
    with torch.no_grad():
        wanted = network(x)
    found = tensor_of(*network.columns(columns_of(x)), rows=100)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-6)


def test_no_compiler(switched, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    switched("auto")
    assert library.why_not() == "no C++ compiler found"


@pytest.mark.skipif(not HERE, reason="not written for this processor")
def test_a_build_that_fails_is_said_and_not_tried_again(monkeypatch, tmp_path):
    calls = tmp_path / "calls"
    fake = tmp_path / "c++"
    fake.write_text(
        f'#!/bin/sh\n[ "$1" = --version ] && echo fake 1.0 && exit 0\n'
        f'echo once >> {calls}\necho "columns.cpp:1: error: no such register" >&2\nexit 1\n'
    )
    fake.chmod(0o755)
    monkeypatch.setenv("CXX", str(fake))
    for _ in range(2):
        with pytest.raises(build.BuildFailed, match="error: no such register"):
            build.library(HERE[0], tmp_path / "made")
    assert calls.read_text() == "once\n"
    assert [p.suffix for p in (tmp_path / "made").iterdir()] == [".failed"]


@pytest.mark.skipif(not HERE, reason="not written for this processor")
def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    if build.compiler() is None:
        pytest.skip("no compiler")
    (tmp_path / "file").write_text("")
    with pytest.raises(build.BuildFailed, match="cannot write to"):
        build.library(HERE[0], tmp_path / "file" / "below")


def test_the_source_is_the_one_that_digests_of_code_know():
    assert build.digest() == build.CONTENT, "write the new digest into build.py"
