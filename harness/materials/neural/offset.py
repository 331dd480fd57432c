r"""The neural offset: where a ray seen from ``wi`` meets the surface under the reference plane.

.. math:: r = F_\mathrm{off}(T_\mathrm{off}(u), \omega_i), \qquad
          u_\mathrm{new} = u + \frac{r}{\max(\omega_{iz}, 0.6)}\,(\omega_{ix}, \omega_{iy})

Eqs. 4-7 of NeuMIP: a network gives the ray's depth r, a fixed function its shift in uv. (The
paper's omega_o, the direction to the camera, is our wi.)
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from harness.core.protocol.disk import cos_theta
from harness.materials.neural import textures
from harness.materials.neural.architecture import Architecture
from harness.nets.mlp import MLP

STEEPEST = 0.6
"""The least cosine that a shift is divided by."""


class Offset(nn.Module):
    """Texture [R^2, C] and network [features, wi.xy] -> depth in units of uv.

    With ``cosines`` the network sees wi.z too.
    """

    def __init__(self, architecture: Architecture):
        super().__init__()
        self.side = architecture.offset_resolution
        self.texture = nn.Parameter(0.1 * torch.randn(self.side**2, architecture.offset_channels))
        hidden = [architecture.width] * architecture.layers
        self.cosines = architecture.cosines
        inputs = architecture.offset_channels + 2 + self.cosines
        # Zero at the start: no shift, as for a flat surface.
        self.network = MLP([inputs, *hidden, 1], architecture.activation, zero_last=True)

    def depth(self, uv: Tensor, wi: Tensor, table: Tensor | None = None) -> Tensor:
        """Ray depth r [N], in units of uv; ``table`` stands in for the texture (blurred)."""
        features = textures.lookup(self.texture if table is None else table, self.side, uv)
        seen = [features, wi, cos_theta(wi)[:, None]] if self.cosines else [features, wi]
        return self.network(torch.cat(seen, 1))[:, 0]

    def forward(self, uv: Tensor, wi: Tensor, table: Tensor | None = None) -> Tensor:
        """The moved coordinates [N, 2]."""
        return uv + shift(self.depth(uv, wi, table), wi)


def shift(depth: Tensor, wi: Tensor) -> Tensor:
    """Eq. 6: the offset [N, 2] of a ray depth [N]."""
    return (depth / cos_theta(wi).clamp(min=STEEPEST))[:, None] * wi
