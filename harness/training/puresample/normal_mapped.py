"""A family of random walks under a normal map (PureSample, Figure 8)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor

from harness.core.protocol.disk import cos_theta
from harness.core.protocol.errors import InputError
from harness.core.refusal import refusal
from harness.microgeometry.description import Description
from harness.microgeometry.walks.kernel import Counts, Exits

RESOLUTION = 256
"""Texels a side of the normal map."""
KEYS = ("fields", "micro")
"""Words of a description that make one: fields, and the height whose slopes the normals have."""


class NormalMapped:
    """Walks of ``family`` in the frame of the normal at the texel where a particle enters.

    As a renderer shades a normal map: the frame is the surface's, turned by the least rotation that
    brings its normal there. A particle that comes from below the turned horizon, or leaves under
    the surface's own, is absorbed.
    """

    grey = False

    def __init__(self, family: Any, words: Mapping[str, Any]):
        self.family, self.name, self.about = family, family.name, family.about
        self.words = dict(words)
        self.normals = _normals(self.name, words)

    def identity(self) -> dict[str, Any]:
        """What determines its walks, as JSON data."""
        return {**self.family.identity(), **self.words}

    def walk(self, u: Tensor, wi: Tensor, channel: Tensor, seed: int, device: str = "cpu") -> Exits:
        """One particle a row, as :func:`harness.microgeometry.walks.kernel.walk`."""
        n = self._normal(u)
        local = turned(torch.cat([wi, cos_theta(wi)[:, None]], 1), n, back=True)
        above = local[:, 2] > 0
        # From below nothing is walked; any direction stands for it.
        start = torch.where(above[:, None], local[:, :2], 0)
        found = self.family.walk(u, start, channel, seed, device)
        wo = found.wo.cpu()
        out = turned(torch.cat([wo, cos_theta(wo)[:, None]], 1), n)
        left = found.left.cpu() & above & (out[:, 2] > 0)
        counts = Counts(
            walks=len(u),
            left=int(left.sum()),
            interactions=found.counts.interactions,
            above_one=found.counts.above_one,
        )
        return Exits(torch.where(left[:, None], out[:, :2], 0), left, found.bounces, counts)

    def _normal(self, u: Tensor) -> Tensor:
        size = len(self.normals)
        column, row = ((u[:, k] * size).long() % size for k in (0, 1))
        return self.normals[row, column]


def turned(v: Tensor, n: Tensor, back: bool = False) -> Tensor:
    r"""``v`` [N, 3] by the least rotation that takes z to the unit normals ``n`` [N, 3], n_z > 0.

    :math:`R v = v + k \times v + \frac{k \times (k \times v)}{1 + n_z}` with
    :math:`k = z \times n` (Rodrigues); ``back`` by its inverse.
    """
    k = torch.stack([-n[:, 1], n[:, 0], torch.zeros_like(n[:, 0])], 1)
    k = -k if back else k
    once = torch.linalg.cross(k, v)
    return v + once + torch.linalg.cross(k, once) / (1 + n[:, 2:])


def _normals(name: str, words: Mapping[str, Any]) -> Tensor:
    """[R, R, 3] of unit length, texels as :mod:`harness.textures` has them."""
    data = {"name": name, "about": "", "colour": [{"colour": "#ffffff"}], **words}
    try:
        description = Description.model_validate(data)
    except ValidationError as error:
        raise InputError(refusal(Description, error)) from None
    description.check()
    micro = description.surface(RESOLUTION).micro
    if micro is None:
        raise InputError("micro: expected a field and its depth, whose slopes the normals have")
    return torch.from_numpy(np.ascontiguousarray(micro, np.float32))
