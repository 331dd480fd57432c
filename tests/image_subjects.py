"""Materials, methods and images for tests of the image checks."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.analysis.records import image_checks as records
from harness.core import registry
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.blocks import Blocks
from harness.stats.ztest import Agreement
from tests.test_rendering import mitsuba

mi = variant.use("cpu")

from harness.rendering.prepared import Prepared  # noqa: E402

BUDGET = Budget(steps=120, conditions=64, directions=32, resolution=32, pool=256)
"""As ``harness check`` fits."""
ALPHA = 1e-3
"""Chance that a right method fails a test of this file; seeds are fixed, so it happens or not."""
STUDIO = scenes.make("studio-sphere")


# --- planted faults --------------------------------------------------------------------


class Tilted(Method):
    """Right, and not the cosine: the density (1 + x / 2) / pi on the disk.

    A point uniform on the disk has its x made positive with probability 1/2 + |x| / 4, else
    negative, which is x's share of the density at x and -x.
    """

    name = "leaning"
    factor = 1.0
    """Of the density it reports, sampled and asked for."""
    limit = math.inf
    """Samples of a larger f / p are dropped."""

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = 2 * math.pi * u[:, 1]
        x, y = (u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)).unbind(-1)
        right = u[:, 2] < 0.5 + x.abs() / 4
        wo = torch.stack([torch.where(right, x.abs(), -x.abs()), y], -1)
        pdf = self.pdf(condition, wo)
        large = 1 / math.pi / pdf > self.limit
        return DiskSample(torch.where(large[:, None], 2.0, wo), pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(inside_disk(wo), self.factor * (1 + wo[:, 0] / 2) / math.pi, 0)


# --- helpers ---------------------------------------------------------------------------


@functools.cache
def grey() -> Material:
    """Lambertian, and not white; one for all, so that its reference images are made once."""
    return mitsuba("diffuse", reflectance={"type": "rgb", "value": 0.4})


def fitted(method: str | Method, material: Material) -> Method:
    """Shortly; tables get a size for tests."""
    if isinstance(method, str):
        small = {"resolution": 16} if method == "tabulated" else {}
        method = registry.make(method, **small)
    method.fit(material, BUDGET, torch.Generator().manual_seed(0))
    return method


@dataclass(frozen=True)
class Image:
    """Mean luminance [H, W] and the variance of that mean."""

    mean: NDArray
    variance: NDArray


def compare(image: Image, expected: Image, mask: NDArray[np.bool_]) -> Agreement:
    """As the records are made, of moments of blocks."""
    blocks = (Blocks.of(one.mean, one.variance, mask) for one in (image, expected))
    return records.compare(*blocks)


def image(prepared: Prepared, spp: int, seed: int, batches: int = 6) -> Image:
    """Of ``batches`` renders of ``spp`` samples each; the variance from their scatter."""
    means = np.array([prepared.render(spp, seed + k).mean for k in range(batches)])
    return Image(means.mean(0), means.var(0, ddof=1) / batches)
