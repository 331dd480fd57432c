"""Small materials to test adapters with, in plain torch, and one of Mitsuba's."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material


class Tilted(Material):
    """A diffuse part and one bump on the disk around a tilted mirror direction.

    Two features, uniform in [0, 1]: roughness and tilt. Both act through bounded functions,
    so that any finite feature gives a finite reflectance.
    """

    name = "tilted"
    n_features = 2

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return {"type": "test", "name": self.name}

    def places(self, uv: Tensor) -> Tensor:
        """The features are the texture coordinates themselves: [N, 2]."""
        return uv

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        width = 0.1 + 0.3 * torch.sigmoid(4 * condition[:, 0] - 2)
        tilt = 0.3 * torch.tanh(2 * condition[:, 1] - 1)
        mean = torch.stack([tilt, 0.5 * tilt], -1) - 0.8 * condition[:, 2:]
        return _bump(wo, mean, width)


class Plain(Material):
    """The same without features: the condition is ``wi.xy`` alone."""

    name = "plain"

    def identity(self) -> dict[str, Any]:
        """See :meth:`Material.identity`."""
        return {"type": "test", "name": self.name}

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return _bump(wo, -0.8 * condition, torch.full_like(condition[:, 0], 0.2))


class HalfBlack(Plain):
    """Black where ``wi.x < 0`` and, elsewhere, for all ``wo`` with ``x < 0``."""

    name = "half-black"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        lit = (condition[:, 0] >= 0) & (wo[:, 0] >= 0)
        return torch.where(lit[:, None], super().eval(condition, wo), 0)


def _bump(wo: Tensor, mean: Tensor, width: Tensor) -> Tensor:
    square = ((wo - mean) / width[:, None]).square().sum(-1)
    bump = (-0.5 * square).exp() / (2 * math.pi * width.square())
    colour = torch.tensor([1.0, 0.8, 0.5], device=wo.device)
    value = 0.2 / math.pi + 0.5 * bump[:, None] * colour
    return torch.where(inside_disk(wo)[:, None], value, 0)


def normal_mapped() -> Material:
    """A principled BSDF with textured roughness under a gentle normal map."""
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    rng = np.random.default_rng(0)
    normals = np.array([0.5, 0.5, 1]) + 0.05 * rng.normal(size=(32, 32, 3))
    roughness = 0.3 + 0.3 * rng.random((32, 32, 1))
    texture = {"type": "bitmap", "raw": True}
    bsdf = {
        "type": "normalmap",
        "normalmap": {**texture, "array": normals.astype("f")},
        "nested": {
            "type": "principled",
            "specular": 0.8,
            "roughness": {**texture, "array": roughness.astype("f")},
        },
    }
    return MitsubaMaterial("normal-mapped", bsdf, {"type": "test", "name": "normal-mapped"})


MATERIALS = {"tilted": Tilted, "plain": Plain, "mitsuba": normal_mapped}
