"""A measured BTF (Bonn ``.btf``) as a material: ``{name, type: btf, file: carpet.btf}``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.microgeometry.measured import MeasuredSurface

FEATURES = (4, 2, 2)
"""How many of each channel's leading texel factors a fitted method sees, at most."""


class BtfMaterial(Material):
    """Interpolated measured reflectance at a place of the picture, no footprint.

    The condition is ``[u, v, features, wi.xy]``; the features are the leading factors of the
    file's own factorisation at (u, v), moved and scaled to mean 0 and deviation 1. Values are
    as measured, so a little below zero in places. It is slow: every value is put together from
    36 products of factors (three lights, three views, four texels).
    """

    n_address = 2

    def __init__(self, name: str, file: Path, identity: dict[str, Any]):
        self.name = name
        self._identity = identity
        self.surface = MeasuredSurface(file)
        columns = [
            channel.texels[:, k]
            for channel, count in zip(self.surface.btf.channels, FEATURES, strict=True)
            for k in range(min(count, channel.texels.shape[1]))
        ]
        # Channels may share their factors, and a factor may be the same everywhere.
        kept: list[np.ndarray] = []
        for column in columns:
            if np.ptp(column) > 0 and not any(np.array_equal(column, other) for other in kept):
                kept.append(column)
        table = np.stack(kept, 1) if kept else np.empty((len(columns[0]), 0), np.float32)
        self._table = (table - table.mean(0)) / table.std(0)
        self.n_features = self._table.shape[1]

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return self._identity

    def places(self, uv: Tensor) -> Tensor:
        """See :meth:`Material.places`."""
        index, weight = self.surface.texels(uv.cpu().numpy())
        features = np.einsum("nk,nkf->nf", weight, self._table[index])
        return torch.cat([uv, torch.from_numpy(features.astype(np.float32)).to(uv.device)], 1)

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        u, wi = condition[:, :2], condition[:, -2:]
        zero = u.new_zeros(len(u))
        f = self.surface.reflectance(u, zero, wi, wo, samples=1, seed=0, device=str(wo.device))
        return torch.where(inside_disk(wo)[:, None], f, 0)

    def why_no_gradient(self) -> str:
        """See :meth:`Material.why_no_gradient`."""
        return (
            f"material '{self.name}' gives no gradient of f: it interpolates measured tables"
            " outside of torch and Dr.Jit"
        )

    def target_gradient(self, condition: Tensor, wo: Tensor) -> tuple[Tensor, Tensor]:
        """See :meth:`Material.target_gradient`; there is none."""
        raise Unsupported(self.why_no_gradient())
