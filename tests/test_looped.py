"""Layers as loops, for GPUs: agreement with torch, and how little code they are.

What Dr.Jit generates for a GPU differs from this in syntax, not in the number of operations; no GPU
is needed to count those.
"""

from __future__ import annotations

import drjit as dr
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of
from harness.nets.looped import LoopedMatrix
from harness.nets.mlp import MLP
from harness.nets.velocity import Velocity

OPERATIONS = 450
"""Of a kernel with one layer; written out, a layer of 64 and 64 has over 8,000."""


def rand(*shape: int, seed: int = 0) -> Tensor:
    """Normal numbers."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def operations(work) -> int:
    """Of the largest kernel that ``work()`` needs."""
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    try:
        dr.eval(work())
        dr.sync_thread()
        entries = [e for e in dr.kernel_history() if e["type"] == dr.KernelType.JIT]
    finally:
        dr.set_flag(dr.JitFlag.KernelHistory, before)
    return max(int(entry["operation_count"]) for entry in entries)


@given(st.integers(1, 70), st.integers(1, 70), st.booleans(), st.integers(0, 99))
@settings(max_examples=12, deadline=None, derandomize=True, database=None)
def test_a_layer_is_torchs(inputs, outputs, biased, seed):
    weight, bias, x = rand(outputs, inputs, seed=seed), rand(outputs), rand(100, inputs, seed=seed)
    columns = columns_of(x)
    matrix = LoopedMatrix(type(columns[0]), weight.numpy(), bias.numpy())
    found = tensor_of(*matrix(columns, biased), rows=100).reshape(100, -1)
    wanted = x @ weight.T + (bias if biased else 0)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5 * inputs)


@pytest.mark.parametrize("size", [32, 64])
def test_a_layers_code_does_not_grow_with_its_size(size):
    columns = columns_of(rand(100, size))
    matrix = LoopedMatrix(type(columns[0]), rand(size, size).numpy(), None)
    assert operations(lambda: matrix(columns)) < OPERATIONS + 6 * size


def test_the_networks_of_the_spline_flow_are_little_code():
    """39-32-32-59 has 4,160 weights; a kernel written out has a load and a product for each."""
    network, columns = MLP([39, 32, 32, 59], "leaky_relu"), columns_of(rand(100, 39))
    assert operations(lambda: network._columns_looped(columns)) < 1500


def test_a_velocity_by_loops_is_that_by_cooperative_vectors():
    torch.manual_seed(0)
    net = Velocity(6, 16, 3)
    torch.nn.init.normal_(net.layers[-1].weight)
    encoded = columns_of(rand(200, 6))
    array = type(encoded[0])
    vectors, loops = net._product("condition", encoded, array), net._looped(array)
    found = tensor_of(*loops["condition"](encoded), rows=200)
    torch.testing.assert_close(found, tensor_of(*vectors, rows=200), rtol=1e-5, atol=1e-6)
    with torch.no_grad():
        net.layers[0].weight.mul_(2)
    assert net._looped(array) is not loops, "made again when a weight has changed"
