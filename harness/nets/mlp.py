"""Small multi-layer perceptrons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import drjit.nn
import numpy as np
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.compiled.library import Library
from harness.core.protocol import counting
from harness.nets import activations
from harness.nets.compiled_network import Packed, usable
from harness.nets.encoding import Encoded
from harness.nets.forms import Forms
from harness.nets.looped import LoopedMatrix


class MLP(nn.Module):
    """Fully connected layers of the given widths, linear at the end.

    ``MLP([30, 32, 32, 5])`` maps [..., 30] to [..., 5] through two hidden layers of 32.
    ``activation`` is one of :data:`harness.nets.activations.ACTIVATIONS`. :meth:`columns` runs
    the same network over Dr.Jit columns with cooperative vectors.

    Example:
        >>> net = MLP([4, 32, 2])
        >>> net(torch.rand(7, 4)).shape
        torch.Size([7, 2])
    """

    def __init__(self, widths: Sequence[int], activation: str = "relu", zero_last: bool = False):
        super().__init__()
        self.layers = nn.ModuleList(
            nn.Linear(a, b) for a, b in zip(widths[:-1], widths[1:], strict=True)
        )
        self.widths = tuple(widths)
        self.activation, self.slope = activation, activations.SLOPES.get(activation)
        if zero_last:
            nn.init.zeros_(self.layers[-1].weight)
            nn.init.zeros_(self.layers[-1].bias)
        self._forms = Forms()

    def forward(self, x: Tensor) -> Tensor:
        """[..., widths[0]] -> [..., widths[-1]]."""
        counting.add("network", x[..., 0].numel())
        for layer in self.layers[:-1]:
            x = activations.value(self.activation, layer(x))
        return self.layers[-1](x)

    def columns(self, x: Columns | Encoded) -> Columns:
        """The network over ``widths[0]`` columns. No gradients by its weights.

        By the compiled kernels where :func:`harness.nets.compiled_network.usable` has them;
        everything before and after is then a Dr.Jit kernel of its own. Otherwise by cooperative
        vectors, or on a GPU by loops, as part of one kernel.
        """
        x = x if isinstance(x, Encoded) else Encoded.plain(x)
        if counting.wanted():
            counting.add("network", max(dr.width(column) for column in x.raw))
        if library := usable(x, widths=self.widths):
            return self.compiled(library)(x)
        inputs = x.inputs
        if dr.backend_v(inputs[-1]) == dr.JitBackend.CUDA:
            return self._columns_looped(inputs)
        weights, biases = self.packed(type(inputs[-1]))
        v = drjit.nn.CoopVec(*inputs)
        for i, (w, b) in enumerate(zip(weights, biases, strict=True)):
            v = drjit.nn.matvec(w, v, b)
            if i < len(weights) - 1:
                v = drjit.nn.CoopVec(*activations.value_columns(self.activation, list(v)))
        return list(v)

    def _columns_looped(self, x: Columns) -> Columns:
        """As loops: 32-bit cooperative vectors do not exist on CUDA."""
        matrices = self.looped(type(x[-1]))
        for i, matrix in enumerate(matrices):
            x = matrix(x)
            if i < len(matrices) - 1:
                x = activations.value_columns(self.activation, x)
        return x

    def looped(self, array: type[Float]) -> list[LoopedMatrix]:
        """The layers for a back end without cooperative vectors."""

        def make(numbers: list[np.ndarray]) -> list[LoopedMatrix]:
            pairs = zip(numbers[0::2], numbers[1::2], strict=True)
            return [LoopedMatrix(array, weight, bias) for weight, bias in pairs]

        return self._kept(f"looped {array.__module__}", make)

    def packed(self, array: type[Float]) -> tuple[list, list]:
        """Weights and biases as packed matrix views."""

        def pack(numbers: list[np.ndarray]) -> tuple[list, list]:
            tensor = dr.tensor_t(array)
            weights = [tensor(np.ascontiguousarray(w)) for w in numbers[0::2]]
            biases = [array(b) for b in numbers[1::2]]
            packed = drjit.nn.pack(*weights, *biases, layout="inference")
            return packed[: len(weights)], packed[len(weights) :]

        return self._kept("matrices", pack)

    def compiled(self, library: Library) -> Packed:
        """The network as the compiled kernels run it."""
        return self._kept("compiled", lambda n: Packed(library, n, self.activation, self.slope))

    def _kept(self, what: str, make: Callable[[list[np.ndarray]], Any]) -> Any:
        return self._forms.of(self.parameters(), what, make)


def count_parameters(module: nn.Module) -> int:
    """Number of fitted numbers in ``module``."""
    return sum(p.numel() for p in module.parameters() if p.requires_grad)


def split_rows(x: Tensor, chunk: int) -> Sequence[Tensor]:
    """``x`` [N, ...] in pieces of at most ``chunk`` rows (one empty piece when N = 0)."""
    return torch.split(x, chunk) if len(x) else (x,)
