r"""Teaches the offset where rays hit, before the textures learn what is seen there.

A ray to the camera ``wi`` through u on the reference plane leaves the surface at a height z known
from tracing, without noise; it is moved by :math:`z\,\omega_i^{xy} / \omega_{iz}`. From reflectance
alone the offset finds that at grazing angles only by way of what is already in the textures.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from torch import Tensor

from harness.core.protocol.disk import cos_theta
from harness.materials.neural import textures
from harness.materials.neural.offset import Offset, shift
from harness.microgeometry import queries
from harness.training.optimiser import adam

RAYS = 1 << 24
"""Rays that are traced, each seen again after all others."""
_BATCH = 1 << 12
_RATES = (2e-2, 5e-3)
"""Of the texture and of the network at first; they fall to nothing along a cosine."""
_BLUR, _HALVINGS = 1 / 32, 6.0
"""The texture's blur, a share of its width, and how often it is halved."""


def known(surface: Any) -> bool:
    """Whether rays can be traced, and hit elsewhere than in the reference plane."""
    return callable(getattr(surface, "heights", None)) and surface.depth > 0


def teach(
    offset: Offset,
    surface: Any,
    steps: int,
    seed: int,
    device: str = "cpu",
    notify: Callable[[float], None] = lambda _share: None,
    rays: int = RAYS,
) -> float:
    """Fit ``offset`` to first hits, in ``steps`` steps of Adam; returns the seconds that took.

    The loss of a lookup that is e texels off is e^2 near nothing and e far from it: at a silhouette
    the hit jumps, and the lookup is to be on one side of it, not between.
    """
    start = time.perf_counter()
    rays = min(rays, steps * _BATCH)
    u, wi, height = queries.rays(surface, rays, seed, device)
    optimiser = adam([[offset.texture], offset.network.parameters()])
    for step in range(steps):
        share = min(1.0, 50 * (step + 1) / steps) * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group, rate in zip(optimiser.param_groups, _RATES, strict=True):
            group["lr"] = rate * share
        first = step * _BATCH % (rays - _BATCH + 1)
        part = slice(first, first + _BATCH)
        sigma = textures.decayed(_BLUR * offset.side, _HALVINGS, step / steps)
        table = textures.blur(offset.texture, offset.side, sigma)
        optimiser.zero_grad(set_to_none=True)
        error = misses(offset, u[part], wi[part], height[part], table).norm(dim=1)
        (error.square() / (1 + error.detach().square()).sqrt()).mean().backward()
        optimiser.step()
        if step % max(1, steps // 20) == 0:
            notify(step / steps)
    return time.perf_counter() - start


def misses(
    offset: Offset, u: Tensor, wi: Tensor, height: Tensor, table: Tensor | None = None
) -> Tensor:
    """By how many texels [N, 2] the lookup is moved too far."""
    right = (height / cos_theta(wi))[:, None] * wi
    return offset.side * (shift(offset.depth(u, wi, table), wi) - right)
