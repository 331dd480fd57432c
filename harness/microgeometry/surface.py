"""A displaced, textured, tileable surface: what a description gives and a query is traced on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.materials.procedural import blur

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """One tile, ``[0, 1)^2`` in uv, that repeats for ever; lengths are in widths of the tile.

    ``height`` [R, R] is the displacement along +z. The *reference plane*, on which footprints
    are centred and light is measured, is z = 0, at the mean height. ``bsdf`` is a Mitsuba
    dictionary in which ``{"type": "bitmap", "array": ndarray}`` stands for a texture of the
    tile; it must be a reflection without delta lobes. ``angle`` [R, R], in radians, turns
    the BSDF's frame about the normal (anisotropy); ``micro`` [R, R, 3] are unit normals
    relative to the surface, for detail that is shaded and not displaced.

    All textures follow :mod:`harness.materials.procedural`: texel (i, j) is centred at
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

    def identity(self) -> dict[str, Any]:
        """What determines the reflectance, as JSON data without paths (for hashes)."""
        if self.source:
            return {"type": "microgeometry", **self.source}
        digest = hashlib.sha256()
        digest.update(json.dumps(_digestible(self.bsdf), sort_keys=True).encode())
        for array in (self.height, self.angle, self.micro):
            digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
        return {
            "type": "microgeometry",
            "sha256": digest.hexdigest(),
            "smooth": self.smooth,
        }

    def tracer(self, device: str) -> Any:
        """The surface as a scene on ``device`` (see harness.microgeometry.tracing), built once."""
        from harness.microgeometry.tracing import Tracer

        if device not in self._tracers:
            self._tracers[device] = Tracer(self, device)
        return self._tracers[device]

    @cached_property
    def _tracers(self) -> dict[str, Any]:
        return {}

    def reflectance(self, *args: Any, **options: Any) -> Any:
        """Path-traced answers to queries; see :func:`harness.microgeometry.queries.truth`."""
        from harness.microgeometry.estimate import reflectance

        return reflectance(self, *args, **options)

    def heights(self, *args: Any, **options: Any) -> Any:
        """Heights of what is seen; see :func:`harness.microgeometry.queries.rays`."""
        from harness.microgeometry.estimate import heights

        return heights(self, *args, **options)

    def energy(self, *args: Any, **options: Any) -> Any:
        """Path-traced energies; see :func:`harness.microgeometry.queries.energy`."""
        from harness.microgeometry.estimate import energy

        return energy(self, *args, **options)


def smoothed(height: Array, width: float) -> Array:
    """``height`` after a Gaussian blur of deviation ``width``, in widths of the tile."""
    return blur(height, width * height.shape[0])


def _digestible(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {str(key): _digestible(value) for key, value in node.items()}
    if isinstance(node, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(node).tobytes()).hexdigest()
        return {"shape": list(node.shape), "sha256": content}
    if isinstance(node, (list, tuple)):
        return [_digestible(value) for value in node]
    return node
