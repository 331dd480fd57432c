"""Feature lookups over Dr.Jit columns: :mod:`.textures` as part of a fused kernel."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.materials.neural import textures

_PACKET = 4


class ColumnTable:
    """One texture or pyramid on the device of an array type.

    Rows are padded to whole packets of four channels, for a packet is gathered at the price of
    one number.
    """

    def __init__(self, table: Tensor, resolution: int, levels: int, array: type[Float]):
        self.resolution, self.levels, self.channels = resolution, levels, table.shape[1]
        self.packets = -(-self.channels // _PACKET)
        padded = np.zeros((len(table), self.packets * _PACKET), dtype=np.float32)
        padded[:, : self.channels] = table.detach().cpu().numpy()
        self.values = array(padded.ravel())
        self.packet = _packet_type(array)
        size = textures.sides(resolution, levels)
        starts = np.concatenate([[0], np.cumsum(np.square(size))[:-1]])
        index = dr.uint32_array_t(array)
        self.size, self.start = index(np.array(size, np.uint32)), index(starts.astype(np.uint32))

    def lookup(self, uv: Columns, level: Float | None = None) -> Columns:
        """Features at ``uv``: bilinear, and trilinear where ``level`` is given."""
        if level is None or self.levels == 1:
            return self._bilinear(uv, self.resolution, 0)
        array = type(uv[0])
        level = dr.clip(level, 0, self.levels - 1)
        lower = dr.minimum(dr.floor(level), self.levels - 2)
        share = level - lower
        # A nan is no level: its share is nan, any texture will do.
        index = dr.uint32_array_t(array)(dr.select(lower == lower, lower, 0))
        found = []
        for which in (index, index + 1):
            size, start = (
                dr.gather(type(which), self.size, which),
                dr.gather(type(which), self.start, which),
            )
            found.append(self._bilinear(uv, size, start))
        return [dr.lerp(a, b, share) for a, b in zip(*found, strict=True)]

    def _bilinear(self, uv: Columns, side: Any, start: Any) -> Columns:
        """The four texels around ``uv`` of the level with ``side`` texels from row ``start``."""
        array = type(uv[0])
        whole, unsigned = dr.int32_array_t(array), dr.uint32_array_t(array)
        size = whole(side)
        first, share = [], []
        for v in uv:
            at = dr.fma(v - dr.floor(v), array(side), -0.5)
            corner = dr.floor(at)
            share.append(at - corner)
            # From -1 up to side - 1. A nan is no address: its weight is nan, any texel will do.
            first.append(dr.clip(whole(dr.select(at == at, corner, 0)), -1, size - 1))
        # Compared and not divided: a vector's idle lanes may hold a side of 0.
        (x0, y0) = [dr.select(i < 0, i + size, i) for i in first]
        (x1, y1) = [dr.select(i + 1 == size, 0, i + 1) for i in first]
        tx, ty = share
        sx, sy = 1 - tx, 1 - ty
        total: Columns = []
        for x, y, weight in (
            (x0, y0, sy * sx),
            (x1, y0, sy * tx),
            (x0, y1, ty * sx),
            (x1, y1, ty * tx),
        ):
            row = (unsigned(dr.fma(y, size, x)) + start) * self.packets
            texel: Columns = []
            for k in range(self.packets):
                texel += list(dr.gather(self.packet, self.values, row + k))
            texel = texel[: self.channels]
            total = (
                [dr.fma(t, weight, s) for t, s in zip(texel, total, strict=True)]
                if total
                else [t * weight for t in texel]
            )
        return total


def _packet_type(array: type[Float]) -> Any:
    """Four arrays of that type, as one gather returns them."""
    if dr.backend_v(array) == dr.JitBackend.CUDA:
        from drjit.cuda.ad import Array4f
    else:
        from drjit.llvm.ad import Array4f
    return Array4f
