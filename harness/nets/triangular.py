"""The networks of a triangular map: of the condition, and of the condition and x."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.material import Material
from harness.nets import spline
from harness.nets.encoding import ConditionEncoder, Encoded, sinusoids
from harness.nets.mlp import MLP

X_WAVES, RANK_WAVES = 3, 2
"""Frequencies at which the second network sees x, and x by its rank."""


class Conditioners(nn.Module):
    """``first`` (condition) -> spline of z1, log scales 2, shifts 2, share; ``second`` (x, its
    rank, condition) -> spline of z2, log scale, shift. Last layers start at zero: uniform."""

    def __init__(self, material: Material, width: int, layers: int, bins: int):
        super().__init__()
        self.encoder = ConditionEncoder(material.n_address, material.n_features)
        encoded, numbers = self.encoder.width, spline.outputs(bins)
        self.seen = 2 + 2 * (X_WAVES + RANK_WAVES)
        self.first = MLP([encoded, width, numbers + 5], "leaky_relu", zero_last=True)
        widths = [self.seen + encoded, *[width] * layers, numbers + 2]
        self.second = MLP(widths, "leaky_relu", zero_last=True)

    def given_x(self, x: Tensor, rank: Tensor, encoded: Tensor) -> Tensor:
        """``second`` at ``x`` and ``rank`` [B, D], ``encoded`` [B, E]: [B, D, outputs]."""
        first, *rest = self.second.layers
        own = torch.cat(
            [sinusoids(x[..., None], X_WAVES), sinusoids(rank[..., None], RANK_WAVES)], -1
        )
        # The condition's share of the first layer is the same for all D directions.
        shared = nn.functional.linear(encoded, first.weight[:, self.seen :], first.bias)
        v = own @ first.weight[:, : self.seen].T + shared[:, None]
        for layer in rest:
            v = layer(nn.functional.leaky_relu(v, self.second.slope))
        return v

    def columns_given_x(self, x: Float, rank: Float, encoded: Encoded) -> Columns:
        """:meth:`given_x` over columns."""
        own = Encoded.waves([x], X_WAVES) + Encoded.waves([rank], RANK_WAVES)
        return self.second.columns(own + encoded)
