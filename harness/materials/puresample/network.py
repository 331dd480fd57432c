r"""The networks of a material learned from walks: density, albedo, latent texture.

.. math:: f_c(\omega_i, \omega_o) = \rho(\omega_o\,|\,\omega_i, c)\,\alpha_c(\omega_i)

for each colour channel c (PureSample, eq. 1), with the latent texture's vector at the place as one
more input of both where the material varies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns
from harness.core.protocol.disk import cos_theta
from harness.materials.neural import textures
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.harmonics import COUNT, harmonics
from harness.nets.conditional_flow import ConditionalFlow
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.mlp import MLP

CHANNELS = 3
"""Red, green, blue."""


@dataclass(frozen=True)
class Inputs:
    """What a flow's encoder asks of a material: the widths of a condition's parts."""

    n_features: int
    n_address: int = 0


class Residual(nn.Module):
    """A perceptron whose hidden layers but the first add to what goes into them, once."""

    def __init__(self, widths: list[int]):
        super().__init__()
        first, *hidden, last = widths
        self.enter = MLP([first, hidden[0]])
        self.body = MLP(hidden)
        self.leave = MLP([hidden[-1], last])

    def forward(self, x: Tensor) -> Tensor:
        """[..., first] -> [..., last]."""
        x = torch.relu(self.enter(x))
        return self.leave(torch.relu(x + self.body(x)))

    def columns(self, x: Columns) -> Columns:
        """The same over columns."""
        import drjit as dr

        x = [dr.maximum(v, 0) for v in self.enter.columns(x)]
        moved = self.body.columns(x)
        return self.leave.columns([dr.maximum(a + b, 0) for a, b in zip(x, moved, strict=True)])


class PureSample(nn.Module):
    """Density, albedo and texture. Uses torch's global generator for its initial weights."""

    def __init__(self, architecture: Architecture):
        super().__init__()
        a = self.architecture = architecture
        self.density = ConditionalFlow(
            Inputs(a.channels + CHANNELS),
            base=a.base,
            domain=a.domain,
            width=a.width,
            layers=a.layers,
            activation=a.activation,
            frequencies=a.frequencies,
            share=a.share,
            framed=a.base != "normal",
        )
        widths = [a.features + COUNT, *[a.albedo_width] * a.albedo_layers, CHANNELS]
        self.albedo_net = Residual(widths) if a.residual else MLP(widths)
        self.texture = None
        if a.textured:
            self.texture = nn.Parameter(0.1 * torch.randn(a.resolution**2, a.features))

    @property
    def flow(self) -> DiscreteFlow:
        """The steps that sample and whose density this is."""
        return DiscreteFlow(self.density.velocity, self.architecture.steps)

    def features(self, uv: Tensor) -> Tensor:
        """Latent vectors [N, features] at ``uv`` [N, 2]; the density's channels come first."""
        if self.texture is None:
            return uv.new_empty(len(uv), 0)
        return textures.lookup(self.texture, self.architecture.resolution, uv)

    def features_beside(self, uv: Tensor) -> Tensor:
        """:meth:`features`, in which the density's channels stand still: without gradient."""
        if self.texture is None:
            return self.features(uv)
        of_density, own = self.texture.tensor_split([self.architecture.channels], 1)
        table = torch.cat([of_density.detach(), own], 1)
        return textures.lookup(table, self.architecture.resolution, uv)

    def condition(self, features: Tensor, channel: Tensor, wi: Tensor) -> Tensor:
        """Rows [N, channels + 3 + 2] of the density's network: texture, one-hot channel, wi."""
        which = torch.zeros_like(channel) if self.architecture.grey else channel
        one_hot = nn.functional.one_hot(which, CHANNELS).to(wi.dtype)
        return torch.cat([features[:, : self.architecture.channels], one_hot, wi], 1)

    def albedo_logit(self, features: Tensor, wi: Tensor) -> Tensor:
        """[N, 3] before the sigmoid: particles that survive are a share from 0 to 1."""
        x, y = wi.unbind(1)
        seen = torch.stack(harmonics(x, y, cos_theta(wi)), 1)
        found = self.albedo_net(torch.cat([features, seen], 1))
        return found[:, :1].expand(-1, CHANNELS) if self.architecture.grey else found

    def albedo(self, features: Tensor, wi: Tensor) -> Tensor:
        """Share [N, 3] of the particles from ``wi`` [N, 2] that leave, per channel."""
        return torch.sigmoid(self.albedo_logit(features, wi))

    def log_density(self, features: Tensor, channel: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        """Log density [N] per disk area at ``wo`` [N, 2] of ``channel`` [N]; nan if not found."""
        rows = self.condition(features, channel, wi)
        found, where = self.density.log_prob(self.flow, rows, wo[:, None])
        return torch.where(where, found, torch.nan)[:, 0]


def at_columns(network: PureSample, features: Columns, channel: Any, wi: Columns) -> Any:
    """What the density's network makes of rows, over columns; ``channel`` an integer column."""
    import drjit as dr

    if network.architecture.grey:
        channel = type(channel)(0)
    one_hot = [dr.select(channel == k, type(wi[0])(1), 0) for k in range(CHANNELS)]
    known = features[: network.architecture.channels]
    return network.density.at_columns([*known, *one_hot, *wi])


def albedo_columns(network: PureSample, features: Columns, wi: Columns) -> Columns:
    """:meth:`PureSample.albedo` over columns."""
    import drjit as dr

    x, y = wi
    z = dr.sqrt(dr.maximum(1 - x * x - y * y, 0))
    raw = network.albedo_net.columns([*features, *harmonics(x, y, z)])
    if network.architecture.grey:
        raw = [raw[0]] * CHANNELS
    return [dr.fma(0.5, dr.tanh(0.5 * v), 0.5) for v in raw]
