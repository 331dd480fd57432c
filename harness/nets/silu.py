"""A perceptron of SiLU units that gives its derivatives in the same pass."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import drjit.nn
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol import counting
from harness.nets.mlp import MLP


class SiluMLP(MLP):
    r"""Linear layers with :math:`v\,\sigma(v)` between them, linear at the end.

    ``tail`` of the inputs, the last ones, are those that derivatives are taken by. Forward mode:
    beside each activation goes its derivative along every one of them, so that a map of the plane
    and its 2 x 2 Jacobian are one pass of three vectors. The first layer's derivatives are columns
    of its matrix and cost nothing.
    """

    def __init__(self, widths: Sequence[int], tail: int = 2):
        super().__init__(widths)
        self.tail = tail

    def forward(self, x: Tensor) -> Tensor:
        """[..., widths[0]] -> [..., widths[-1]]."""
        counting.add("network", x[..., 0].numel())
        for layer in self.layers[:-1]:
            x = nn.functional.silu(layer(x))
        return self.layers[-1](x)

    def with_slopes(self, head: Tensor, tail: Tensor) -> tuple[Tensor, Tensor]:
        """Outputs [B, D, out] and their derivatives by ``tail``, [B, D, tail, out].

        ``head`` [B, E] are the first inputs, the same for all D of ``tail`` [B, D, tail]: their
        share of the first layer is found once. Differentiable, by the weights and by the inputs.
        """
        counting.add("network", tail[..., 0].numel())
        first, *rest = self.layers
        e = head.shape[-1]
        own = first.weight[:, e:]
        x = tail @ own.T + nn.functional.linear(head, first.weight[:, :e], first.bias)[:, None]
        slopes = own.T.expand(*tail.shape[:-1], *own.T.shape)
        for layer in rest:
            gate = torch.sigmoid(x)
            slopes = (gate * (1 + x * (1 - gate)))[..., None, :] * slopes
            x = layer(x * gate)
            slopes = slopes @ layer.weight.T
        return x, slopes

    def columns(self, x: Columns) -> Columns:
        """The network over columns."""
        return self.columns_with_slopes(x, 0)[0]

    def columns_with_slopes(
        self, x: Columns, tail: int | None = None
    ) -> tuple[Columns, list[Columns]]:
        """Outputs, and their derivatives by each of the last ``tail`` inputs (all that it has)."""
        if counting.wanted():
            counting.add("network", max(dr.width(column) for column in x))
        count = self.tail if tail is None else tail
        array = type(x[-1])
        first = self.layers[0].weight.detach().float().cpu()
        width = first.shape[1]
        slopes = [[array(w) for w in first[:, width - count + k].tolist()] for k in range(count)]
        apply = self._products(array)
        x = apply(0, x, True)
        for i in range(1, len(self.layers)):
            gates = [1 / (1 + dr.exp(-v)) for v in x]
            bends = [g * dr.fma(v, 1 - g, 1) for v, g in zip(x, gates, strict=True)]
            slopes = [[b * s for b, s in zip(bends, t, strict=True)] for t in slopes]
            x = apply(i, [v * g for v, g in zip(x, gates, strict=True)], True)
            slopes = [apply(i, t, False) for t in slopes]
        return x, slopes

    def _products(self, array: type[Float]):
        """``apply(layer, columns, with its bias)`` for arrays of one type."""
        if dr.backend_v(array) != dr.JitBackend.CUDA:
            weights, biases = self.packed(array)

            def packed(i: int, v: Columns, bias: bool) -> Columns:
                vector = drjit.nn.CoopVec(*v)
                return list(
                    drjit.nn.matvec(weights[i], vector, biases[i])
                    if bias
                    else drjit.nn.matvec(weights[i], vector)
                )

            return packed

        def written_out(i: int, v: Columns, bias: bool) -> Columns:
            # 32-bit cooperative vectors do not exist on CUDA.
            layer = self.layers[i]
            w = array(layer.weight.detach().float().reshape(-1).contiguous())
            b = array(layer.bias.detach().float().contiguous())
            out = []
            for row in range(layer.out_features):
                s = dr.gather(array, b, row) if bias else array(0)
                for k, value in enumerate(v):
                    s = dr.fma(dr.gather(array, w, row * layer.in_features + k), value, s)
                out.append(s)
            return out

        return written_out
