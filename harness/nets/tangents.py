"""A network together with its derivatives, by forward differentiation: in torch, over columns."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import drjit.nn
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol import counting
from harness.nets import activations
from harness.nets.mlp import MLP


def slopes_by_last(mlp: MLP, head: Tensor, tail: Tensor) -> tuple[Tensor, Tensor]:
    """Outputs [B, D, out] and their derivatives by the last T inputs, [T, B, D, out].

    ``head`` [B, E] are the first inputs, the same for all D of ``tail`` [B, D, T]: their share of
    the first layer is found once. Differentiable, by the weights and by the inputs.
    """
    counting.add("network", tail[..., 0].numel())
    first, *rest = mlp.layers
    e = head.shape[-1]
    own = first.weight[:, e:]
    x = tail @ own.T + nn.functional.linear(head, first.weight[:, :e], first.bias)[:, None]
    slopes = own.T[:, None, None].expand(-1, *x.shape)
    for layer in rest:
        x, slopes = activations.push(mlp.activation, x, slopes)
        x, slopes = layer(x), slopes @ layer.weight.T
    return x, slopes


def slopes_by_last_columns(mlp: MLP, x: Columns, count: int) -> tuple[Columns, list[Columns]]:
    """Outputs, and their derivatives by each of the last ``count`` inputs.

    Those of the first layer are columns of its matrix, so one layer is spared.
    """
    array = type(x[-1])
    weight = mlp.layers[0].weight.detach().float().cpu()
    width = weight.shape[1]
    slopes = [[array(w) for w in weight[:, width - count + k].tolist()] for k in range(count)]
    product = _products(mlp, array)
    return _onward(mlp, product, product(0, x, True), slopes)


def with_tangents(mlp: MLP, x: Columns, tangents: list[Columns]) -> tuple[Columns, list[Columns]]:
    """Outputs of ``mlp`` at ``x``, and their derivatives along each of ``tangents``.

    Each costs as much as the network itself. Where a hidden neuron is at its kink the
    derivative is that of its negative side.
    """
    product = _products(mlp, type(x[-1]))
    return _onward(mlp, product, product(0, x, True), [product(0, t, False) for t in tangents])


Product = Callable[[int, Columns, bool], Columns]
"""``product(layer, x, biased)``: a layer's matrix times ``x``, with its bias or without."""


def _onward(
    mlp: MLP, product: Product, x: Columns, tangents: list[Columns]
) -> tuple[Columns, list[Columns]]:
    """From the first layer's outputs and their derivatives to the last one's."""
    if counting.wanted():
        counting.add("network", max(dr.width(column) for column in x))
    for i in range(1, len(mlp.layers)):
        x, bends = activations.with_slope_columns(mlp.activation, x)
        tangents = [[b * v for b, v in zip(bends, t, strict=True)] for t in tangents]
        x = product(i, x, True)
        tangents = [product(i, t, False) for t in tangents]
    return x, tangents


def _products(mlp: MLP, array: type[Float]) -> Product:
    """The layers' products for arrays of one type."""
    if dr.backend_v(array) != dr.JitBackend.CUDA:
        weights, biases = mlp.packed(array)

        def packed(i: int, v: Columns, biased: bool) -> Columns:
            vector = drjit.nn.CoopVec(*v)
            if biased:
                return list(drjit.nn.matvec(weights[i], vector, biases[i]))
            return list(drjit.nn.matvec(weights[i], vector))

        return packed

    # 32-bit cooperative vectors do not exist on CUDA.
    matrices = mlp.looped(array)
    return lambda i, v, biased: matrices[i](v, biased)
