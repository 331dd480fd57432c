"""A displaced surface that answers queries: what a description gives."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from harness.microgeometry import estimate
from harness.microgeometry.tile import Tile
from harness.microgeometry.tracing import Tracer


class Surface(Tile):
    """A :class:`~harness.microgeometry.tile.Tile` with path-traced answers about it."""

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

    def tracer(self, device: str) -> Tracer:
        """The surface as a scene on ``device``, built once."""
        if device not in self._tracers:
            self._tracers[device] = Tracer(self, device)
        return self._tracers[device]

    @cached_property
    def _tracers(self) -> dict[str, Tracer]:
        return {}

    def reflectance(self, *args: Any, device: str = "cpu", **options: Any) -> Any:
        """Path-traced answers to queries; see :func:`harness.microgeometry.queries.truth`."""
        return estimate.reflectance(self.tracer(device), *args, device=device, **options)

    def heights(self, *args: Any, device: str = "cpu") -> Any:
        """Heights of what is seen; see :func:`harness.microgeometry.queries.rays`."""
        return estimate.heights(self.tracer(device), *args, device=device)

    def energy(self, *args: Any, device: str = "cpu", **options: Any) -> Any:
        """Path-traced energies; see :func:`harness.microgeometry.queries.energy`."""
        return estimate.energy(self.tracer(device), *args, device=device, **options)


def _digestible(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {str(key): _digestible(value) for key, value in node.items()}
    if isinstance(node, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(node).tobytes()).hexdigest()
        return {"shape": list(node.shape), "sha256": content}
    if isinstance(node, (list, tuple)):
        return [_digestible(value) for value in node]
    return node
