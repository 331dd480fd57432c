r"""The whole network, eq. 8 of NeuMIP.

.. math:: M(u, \sigma, \omega_i, \omega_o)
          = F(P(u + O(u, \omega_i), \sigma), \omega_i, \omega_o)
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from harness.core.protocol.disk import cos_theta
from harness.materials.neural import textures
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.offset import Offset
from harness.nets.mlp import MLP


class NeuralMBTF(nn.Module):
    """Offset, feature textures and decoder.

    Uses torch's global generator for its initial weights. ``decode`` is linear at its end
    while training and non-negative in :meth:`reflectance`.
    """

    def __init__(self, architecture: Architecture):
        super().__init__()
        a = self.architecture = architecture
        self.offset = Offset(a) if a.offset else None
        self.texture = nn.Parameter(
            0.1 * torch.randn(textures.rows(a.resolution, a.levels), a.channels)
        )
        self.decoder = MLP([a.directions + a.channels, *[a.width] * a.layers, 3], a.activation)

    def blurred(self, sigma: float) -> tuple[Tensor, Tensor | None]:
        """Feature and offset tables after a Gaussian blur of ``sigma`` texels."""
        a = self.architecture
        table = textures.blur_pyramid(self.texture, a.resolution, a.levels, sigma)
        if self.offset is None:
            return table, None
        return table, textures.blur(self.offset.texture, self.offset.side, sigma)

    def features(
        self,
        uv: Tensor,
        wi: Tensor,
        level: Tensor | None = None,
        tables: tuple[Tensor, Tensor | None] | None = None,
        parallax: bool = True,
    ) -> Tensor:
        """Stage 1: features [N, C] at ``uv`` [N, 2] seen from ``wi`` [N, 2].

        ``level`` [N] of detail (0, the finest, if not given), for a pyramid. ``tables`` are
        :meth:`blurred`'s. Without ``parallax`` the lookup is not moved.
        """
        a = self.architecture
        table, offset_table = tables if tables is not None else (self.texture, None)
        if self.offset is not None and parallax:
            uv = self.offset(uv, wi, offset_table)
        if not a.pyramid:
            return textures.lookup(table, a.resolution, uv)
        level = uv.new_zeros(len(uv)) if level is None else level
        return textures.lookup_pyramid(table, a.resolution, a.levels, uv, level)

    def decode(self, features: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        """Stage 2 before its final ReLU: [N, 3], negative where the fit undershoots."""
        directions = [wo, wi]
        if self.architecture.half_vector:
            directions.append(half_vector(wi, wo))
        if self.architecture.cosines:
            directions += [cos_theta(wi)[:, None], cos_theta(wo)[:, None]]
        raw = self.decoder(torch.cat([*directions, features], -1))
        return torch.expm1(raw) if self.architecture.output == "log1p" else raw

    def reflectance(self, features: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
        """Stage 2: BSDF [N, 3] without cosine, not negative; ``wo`` is not tested for the disk."""
        return torch.relu(self.decode(features, wi, wo))

    def forward(
        self,
        uv: Tensor,
        wi: Tensor,
        wo: Tensor,
        level: Tensor | None = None,
        tables: tuple[Tensor, Tensor | None] | None = None,
    ) -> Tensor:
        """Both stages, without the final ReLU: what a fit compares with its data."""
        return self.decode(self.features(uv, wi, level, tables), wi, wo)

    @torch.no_grad()
    def bake(self, sigma: float, offset_sigma: float | None = None) -> None:
        """Blur the textures once and for all, by ``sigma`` texels."""
        a = self.architecture
        self.texture.copy_(textures.blur_pyramid(self.texture, a.resolution, a.levels, sigma))
        if self.offset is not None:
            offset_sigma = sigma if offset_sigma is None else offset_sigma
            blurred = textures.blur(self.offset.texture, self.offset.side, offset_sigma)
            self.offset.texture.copy_(blurred)


def half_vector(wi: Tensor, wo: Tensor) -> Tensor:
    """Projection [N, 2] of the unit vector half way between two directions [N, 2]."""
    z = cos_theta(wi) + cos_theta(wo)
    total = wi + wo
    squared = total.square().sum(-1) + z.square()
    # Opposite directions on the horizon have none: their sum is 0, and 0 over 1 is as good.
    return total * torch.where(squared > 0, squared, 1).rsqrt()[..., None]
