r"""Encodings of numbers of [0, 1]: frequencies and one-blob, as Table 1 of Bai et al. (2023).

``freq`` of n numbers: :math:`\sin, \cos(2^i \pi x)` for i < n / 2 (Mildenhall et al. 2020);
``blob`` of n numbers: Gaussians of deviation 1 / n at n places of [0, 1] (Müller et al. 2019);
``identity``: x itself. Each once in torch, once over columns, and with its derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.material import Material


@dataclass(frozen=True)
class Encoding:
    """``size`` numbers for one; ``saturating``: of 1 - e^-x, brought back to [0, 1]."""

    kind: str
    size: int
    saturating: bool = False

    def __call__(self, x: Tensor) -> Tensor:
        """[...] in [0, 1] -> [..., size]."""
        if self.saturating:
            x = -torch.expm1(-x) / (1 - math.exp(-1))
        if self.kind == "identity":
            return x[..., None]
        if self.kind == "freq":
            angle = x[..., None] * (math.pi * 2.0 ** torch.arange(self.size // 2, device=x.device))
            return torch.cat([angle.sin(), angle.cos()], -1)
        place = (torch.arange(self.size, device=x.device) + 0.5) / self.size
        return torch.exp(-0.5 * ((x[..., None] - place) * self.size).square())

    def columns(self, x: Float) -> tuple[Columns, Columns]:
        """The same over a column, and the derivatives by x."""
        slope = type(x)(1)
        if self.saturating:
            scale = 1 / (1 - math.exp(-1))
            slope = scale * dr.exp(-x)
            x = scale * (1 - dr.exp(-x))
        if self.kind == "identity":
            return [x], [slope]
        values, slopes = [], []
        if self.kind == "freq":
            waves = [dr.sincos(x * (math.pi * 2**i)) for i in range(self.size // 2)]
            factors = [slope * (math.pi * 2**i) for i in range(self.size // 2)]
            values = [s for s, _ in waves] + [c for _, c in waves]
            slopes = [f * c for f, (_, c) in zip(factors, waves, strict=True)]
            slopes += [-f * s for f, (s, _) in zip(factors, waves, strict=True)]
            return values, slopes
        for i in range(self.size):
            z = dr.fma(x, self.size, -(i + 0.5))
            values.append(dr.exp(-0.5 * z * z))
            slopes.append(-self.size * z * values[-1] * slope)
        return values, slopes


_FREQ4, _FREQ12 = Encoding("freq", 4), Encoding("freq", 12)
_BLOB12 = Encoding("blob", 12)
TABLE_1: dict[str, tuple[dict[str, Encoding], Encoding]] = {
    "ggx-conductor": (
        dict.fromkeys(("alpha_x", "alpha_y", "r0_r", "r0_g", "r0_b"), _FREQ4),
        _FREQ12,
    ),
    "layered": (
        {
            "eta": Encoding("blob", 4),
            "alpha": Encoding("blob", 4, saturating=True),
            "sigma_t": Encoding("blob", 5),
            **dict.fromkeys(("albedo_r", "albedo_g", "albedo_b"), Encoding("identity", 1)),
        },
        _BLOB12,
    ),
    "disney": (
        {"metallic": Encoding("blob", 8), "roughness": Encoding("blob", 8, saturating=True)},
        _BLOB12,
    ),
}
"""By family: encodings of the parameters, and that of directions and uniforms."""
OTHER = Encoding("blob", 4)
"""Of a feature that the table does not have."""


class TableEncoder(nn.Module):
    """Condition [..., C] -> [..., width]: features by their encodings, then ``wi.xy``.

    Features are brought to [0, 1] by the range that :meth:`fit_range` finds.
    """

    def __init__(self, material: Material):
        super().__init__()
        named, self.direction = TABLE_1.get(material.family, ({}, _BLOB12))
        names = [p.name for p in material.parameters]
        names += [""] * (material.n_features - len(names))
        self.features = [named.get(name, OTHER) for name in names]
        self.n_address = material.n_address
        self.register_buffer("low", torch.zeros(material.n_features))
        self.register_buffer("scale", torch.ones(material.n_features))
        self.width = sum(e.size for e in self.features) + 2 * self.direction.size

    def fit_range(self, condition: Tensor) -> None:
        """Set the features' range from ``condition`` [N, C]."""
        first, last = self.n_address, self.n_address + len(self.features)
        if first == last:
            return
        features = condition[:, first:last]
        low, high = features.amin(0), features.amax(0)
        self.low.copy_(low)
        # A feature that never varies carries nothing; any finite scale will do.
        self.scale.copy_(torch.where(high > low, 1 / (high - low), torch.ones_like(low)))

    def forward(self, condition: Tensor) -> Tensor:
        """[..., C] -> [..., width]."""
        first, last = self.n_address, self.n_address + len(self.features)
        features = (condition[..., first:last] - self.low) * self.scale
        parts = [e(features[..., i]) for i, e in enumerate(self.features)]
        parts.append(self.point((condition[..., last : last + 2] + 1) / 2))
        return torch.cat(parts, -1)

    def point(self, square: Tensor) -> Tensor:
        """Points [..., 2] of the unit square, encoded as directions are: [..., 2 size]."""
        return torch.cat([self.direction(square[..., i]) for i in (0, 1)], -1)

    def columns(self, c: Columns) -> Columns:
        """:meth:`forward` over columns."""
        first, last = self.n_address, self.n_address + len(self.features)
        low, scale = self.low.tolist(), self.scale.tolist()
        found: Columns = []
        for i, e in enumerate(self.features):
            found += e.columns((c[first + i] - low[i]) * scale[i])[0]
        return found + self.point_columns([dr.fma(0.5, v, 0.5) for v in c[last : last + 2]])[0]

    def point_columns(self, square: Columns) -> tuple[Columns, list[Columns]]:
        """:meth:`point` over columns, and its derivatives by either coordinate."""
        (a, da), (b, db) = (self.direction.columns(v) for v in square)
        zeros = [type(a[0])(0)] * len(a)
        return a + b, [da + zeros, zeros + db]
