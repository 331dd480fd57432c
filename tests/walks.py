"""What the tests of both families of random walks need."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.materials import registry
from harness.stats.chisquare import ChiSquare, chi_square

CELLS = 12


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def family(name: str, walks: int | None = None, **fix: float) -> Material:
    """A family with some parameters fixed."""
    spec = {"name": "mine", "type": "family", "family": name, "fix": fix}
    return registry.make({**spec, "walks": walks} if walks else spec)


def exits(material: Material, row: Tensor, n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Directions [n, 2] and weights [n, 3] of walks from the condition ``row`` [C]."""
    return material.walk_sample(
        row.expand(n, -1).contiguous(), torch.rand(n, 3, generator=rng(seed))
    )


def diffuse_exits(material: Material, n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Those of cosine-weighted light: ``wi`` uniform on the disk; no parameters are free."""
    wi = square_to_disk(torch.rand(n, 2, generator=rng(seed)))
    return material.walk_sample(wi, torch.rand(n, 3, generator=rng(seed + 1)))


def uniform_on_disk(wo: Tensor) -> ChiSquare:
    """Chi-square of points [n, 2] against the uniform disk, in cells of equal area."""
    cell = (disk_to_square(wo.double()) * CELLS).long().clamp(0, CELLS - 1)
    count = np.bincount(cell[:, 0] * CELLS + cell[:, 1], minlength=CELLS**2)
    return chi_square(count.astype(float), np.full(CELLS**2, len(wo) / CELLS**2))


def albedo(material: Material, row: Tensor, n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Integral of ``eval`` over the disk, rgb, and its standard error.

    At points of the native sampler, whose density is exact.
    """
    from harness._methods.native import Native

    method = Native()
    method.bind(material)
    rows = row.expand(n, -1).contiguous()
    weight = method.sample_weighted(rows, torch.rand(n, 3, generator=rng(seed))).weight.double()
    return weight.mean(0), weight.std(0) / math.sqrt(n)


def binned(material: Material, row: Tensor, n: int, seed: int) -> tuple[Tensor, Tensor]:
    """Energy that walks bring into cells of equal area, [CELLS^2, 3], and its standard errors."""
    wo, weight = exits(material, row, n, seed)
    weight = torch.where(inside_disk(wo)[:, None], weight, 0).double()
    square = disk_to_square(torch.where(inside_disk(wo)[:, None], wo, 0).double())
    cell = (square * CELLS).long().clamp(0, CELLS - 1)
    index = cell[:, 0] * CELLS + cell[:, 1]
    total, squares = torch.zeros(2, CELLS**2, 3, dtype=torch.float64)
    total.index_add_(0, index, weight)
    squares.index_add_(0, index, weight.square())
    mean = total / n
    return mean, ((squares / n - mean.square()).clamp(min=0) / n).sqrt()


def evaluated(material: Material, row: Tensor, per_cell: int, seed: int) -> tuple[Tensor, Tensor]:
    """The same by ``eval`` at ``per_cell`` random points of each cell."""
    u = torch.rand(CELLS, CELLS, per_cell, 2, generator=rng(seed))
    at = torch.arange(CELLS)
    corner = torch.stack(torch.meshgrid(at, at, indexing="ij"), -1)[:, :, None]
    wo = square_to_disk(((corner + u) / CELLS).reshape(-1, 2))
    value = material.eval(row.expand(len(wo), -1).contiguous(), wo).double()
    value = value.view(CELLS**2, per_cell, 3) * (math.pi / CELLS**2)
    return value.mean(1), value.std(1) / math.sqrt(per_cell)


def z_scores(a: tuple[Tensor, Tensor], b: tuple[Tensor, Tensor]) -> Tensor:
    """Differences in standard errors, of pairs of (mean, standard error)."""
    error = (a[1].square() + b[1].square()).sqrt()
    return ((a[0] - b[0]) / error)[error > 0]
