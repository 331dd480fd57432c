"""The data of a displaced, textured, tileable surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tile:
    """One tile, ``[0, 1)^2`` in uv, that repeats for ever; lengths are in widths of the tile.

    ``height`` [R, R] is the displacement along +z. The *reference plane*, on which footprints
    are centred and light is measured, is z = 0, at the mean height. ``bsdf`` is a Mitsuba
    dictionary in which ``{"type": "bitmap", "array": ndarray}`` stands for a texture of the
    tile; it must be a reflection without delta lobes. ``angle`` [R, R], in radians, turns
    the BSDF's frame about the normal (anisotropy); ``micro`` [R, R, 3] are unit normals
    relative to the surface, for detail that is shaded and not displaced.

    All textures follow :mod:`harness.textures`: texel (i, j) is centred at
    ``v = (i + 1/2) / R``, ``u = (j + 1/2) / R``.
    """

    name: str
    height: Array
    bsdf: Mapping[str, Any]
    angle: Array | None = None
    micro: Array | None = None
    smooth: bool = True
    """Interpolate normals over the mesh; False shades its flat triangles."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """What it was made from, as JSON data; empty: the arrays themselves."""

    def __post_init__(self) -> None:
        h = self.height
        if h.ndim != 2 or h.shape[0] != h.shape[1] or h.shape[0] % 4 or not np.isfinite(h).all():
            raise ValueError(
                f"height: expected finite values [R, R] with R a multiple of 4, got {h.shape}"
            )
        object.__setattr__(self, "height", h - h.mean())

    @property
    def resolution(self) -> int:
        """Texels along each side of the tile."""
        return self.height.shape[0]

    @cached_property
    def slope(self) -> float:
        """Root mean square of the height's gradient (rise over run)."""
        du = (np.roll(self.height, -1, 1) - np.roll(self.height, 1, 1)) * self.resolution / 2
        dv = (np.roll(self.height, -1, 0) - np.roll(self.height, 1, 0)) * self.resolution / 2
        return float(np.sqrt((du**2 + dv**2).mean()))

    @property
    def depth(self) -> float:
        """From the lowest to the highest point, in widths of the tile."""
        return float(np.ptp(self.height))
