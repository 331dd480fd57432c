"""Pictures of a surface for walks: from above, and where particles leave it."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from harness.core.streams import generator
from harness.microgeometry.preview import srgb
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks.surface import WalkedSurface

DIRECTIONS = ((0.0, 0.0), (0.5, 0.2), (-0.8, 0.3))
"""``wi`` of the pictures of exits."""

_LIGHT = (-0.45, 0.5, 0.74)


def plan(surface: WalkedSurface, size: int, device: str = "cpu") -> Tensor:
    """The tile from above, [size, size, 3] linear: tint and reflectance, shaded by the normal."""
    geometry = surface.geometry(device)
    mi = geometry.mi
    at = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(at.flip(0), at, indexing="ij")
    x, y = (mi.Float(np.ravel(w.numpy())) for w in (u, v))
    up = mi.Vector3f(0, 0, 1)
    hit = geometry.hit(geometry.first(x, y, up), -up, mi.Mask(True))
    light = dr.maximum(dr.dot(hit.si.sh_frame.n, dr.normalize(mi.Vector3f(*_LIGHT))), 0)
    share = geometry.shares[0]
    if hit.second is not None:
        share = dr.select(hit.second, geometry.shares[1], share)
    found = np.array((0.15 + 0.85 * light) * hit.tint * share).T
    return torch.from_numpy(np.ascontiguousarray(found)).view(size, size, 3)


def exits(
    surface: Any, wi: tuple[float, float], cells: int, walks: int, seed: int, device: str = "cpu"
) -> Tensor:
    """Mean of f over cells of the disk's square, [cells, cells, 3], rows from the top.

    By ``walks`` particles a channel from one direction, at places all over the tile.
    """
    images = []
    area = (2 / cells) ** 2
    for channel in range(3):
        u = torch.rand(walks, 2, generator=generator(seed + channel))
        at = torch.tensor(wi).expand(walks, 2).contiguous()
        of = torch.full((walks,), channel)
        found = surface.walk(u, at, of, seed + channel, device)
        x, y = found.wo[found.left].cpu().numpy().T
        count, _, _ = np.histogram2d(-y, x, bins=cells, range=[[-1, 1]] * 2)
        images.append(torch.from_numpy(count / (walks * area)))
    return torch.stack(images, -1).float()


def strip(surface: WalkedSurface, size: int, walks: int, device: str = "cpu") -> np.ndarray:
    """One row of pictures [size, 4 size, 3] in sRGB: the tile, and exits from three directions.

    Exits are log(1 + f), as bright as their brightest percentile allows; white off the disk.
    """
    rows = [plan(surface, size, device).numpy()]
    cells = size // 2
    at = (np.arange(cells) + 0.5) / cells * 2 - 1
    off = at[:, None] ** 2 + at**2 > 1
    for wi in DIRECTIONS:
        image = np.log1p(exits(surface, wi, cells, walks, 1, device).numpy())
        image /= np.percentile(image[~off], 99.5)
        image[off] = 1
        rows.append(np.kron(image, np.ones((2, 2, 1))))
    return srgb(np.concatenate(rows, 1))


def about(surface: WalkedSurface) -> str:
    """One line of numbers."""
    if isinstance(surface.shape, Tile):
        return f"facets of rms slope {surface.shape.slope:.2f}"
    covered = float((surface.shape.heights(256) > 0).mean())
    n = len(surface.shape.centre)
    height = surface.shape.top * math.sqrt(n)
    return f"{n} primitives cover {covered:.0%}, {height:.2f} spacings high"
