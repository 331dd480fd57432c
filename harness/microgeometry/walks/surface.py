"""A surface that particles walk through: what a description gives, and what trainings ask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks.kernel import BOUND, Exits, walk
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.primitives import Primitives

WALKED = "walked microgeometry"
"""The type of a described bed or facet field; a relief has its own."""


@dataclass(frozen=True, eq=False)
class WalkedSurface:
    """A bed of primitives over a ground, or a height field, with its micro-BSDF.

    Answers :meth:`walk`; ``source`` is what it was made from, as JSON data without paths.
    """

    name: str
    about: str
    shape: Primitives | Tile
    micro: MicroBSDF
    ground: MicroBSDF
    bound: int = BOUND
    source: Mapping[str, Any] = field(default_factory=dict)
    _geometries: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def grey(self) -> bool:
        """Whether all three channels walk alike, as far as the numbers of its description say."""
        colours = [self.micro.reflectance, self.ground.reflectance]
        tinted = isinstance(self.shape, Primitives) and bool(
            (self.shape.tint != self.shape.tint[:, :1]).any()
        )
        return not tinted and all(len(set(colour)) == 1 for colour in colours)

    def identity(self) -> dict[str, Any]:
        """What determines its walks, as JSON data without paths."""
        return {"type": WALKED, **self.source}

    def geometry(self, device: str) -> Any:
        """For rays on ``device``, built once."""
        if device not in self._geometries:
            self._geometries[device] = self._built(device)
        return self._geometries[device]

    def _built(self, device: str) -> Any:
        from harness.microgeometry.walks.bed import Bed
        from harness.microgeometry.walks.heightfield import Heightfield
        from harness.mitsuba_runtime.variant import use

        try:
            if isinstance(self.shape, Tile):
                return Heightfield(self.shape, self.micro, device)
            mi = use(device)
            return Bed(mi, self.shape, self.micro, self.ground, self.shape.mean_height)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None

    def walk(self, u: Tensor, wi: Tensor, channel: Tensor, seed: int, device: str = "cpu") -> Exits:
        """See :func:`harness.microgeometry.walks.kernel.walk`."""
        with torch.inference_mode():
            found = walk(self.geometry(device), u, wi, channel, seed, self.bound, device)
        return Exits(found.wo.clone(), found.left.clone(), found.bounces.clone(), found.counts)
