"""The conditioner of a coupling: parameters of one coordinate's map from the other one."""

from __future__ import annotations

import math

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.nets.encoding import Encoded, sinusoids
from harness.nets.mlp import MLP


class CouplingNet(nn.Module):
    """[encoded coordinate, encoded condition] -> ``layers`` hidden layers -> ``outputs``.

    The coordinate enters with its sines and cosines at ``frequencies`` octaves (9 numbers
    for 4). LeakyReLU of slope 0.01; the last layer starts at zero, so that a coupling
    starts as the map that zeros stand for.
    """

    def __init__(
        self, encoded: int, width: int, outputs: int, frequencies: int = 4, layers: int = 2
    ):
        super().__init__()
        self.frequencies = frequencies
        self.waves = 1 + 2 * frequencies
        widths = [self.waves + encoded, *[width] * layers, outputs]
        self.mlp = MLP(widths, "leaky_relu", zero_last=True)

    def forward(self, coordinate: Tensor, encoded: Tensor) -> Tensor:
        """[B, D] and [B, E] -> [B, D, outputs]: B conditions, D directions each."""
        first, *rest = self.mlp.layers
        # The condition's share of the first layer is the same for all D directions.
        shared = nn.functional.linear(encoded, first.weight[:, self.waves :], first.bias)
        waves = sinusoids(coordinate[..., None], self.frequencies)
        x = waves @ first.weight[:, : self.waves].T + shared[:, None]
        for layer in rest:
            x = layer(nn.functional.leaky_relu(x, self.mlp.slope))
        return x

    def columns(self, coordinate: Float, encoded: Encoded) -> Columns:
        """The same over columns."""
        return self.mlp.columns(Encoded.waves([coordinate], self.frequencies) + encoded)


def unit_normal_columns(u: Columns) -> tuple[Float, Float]:
    """Two independent standard normals from two uniforms in [0, 1): Box and Muller (1958)."""
    sin, cos = dr.sincos(2 * math.pi * u[1])
    # 1 - u is at least 2^-24, so the logarithm is finite.
    radius = dr.sqrt(-2 * dr.log(1 - u[0]))
    return radius * cos, radius * sin


def uniforms_of_normal(z: Tensor) -> Tensor:
    """The two uniforms [..., 2] that :func:`unit_normal_columns` maps to ``z`` [..., 2].

    Uniforms end below 1, so no sample is further out than the radius 5.77 of single
    precision; a ``z`` beyond gets the largest uniform that there is.
    """
    largest = 1 - torch.finfo(torch.float32).eps / 2
    x, y = z.unbind(-1)
    radius = -torch.expm1(-0.5 * (x * x + y * y))
    turn = torch.remainder(torch.atan2(y, x) / (2 * math.pi), 1.0)
    return torch.stack([radius, turn], -1).clamp(max=largest)
