"""The target density p*, tabulated for a pool of conditions."""

from __future__ import annotations

import functools
import math
import time
from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget

_ROWS = 1 << 22
"""Target evaluations per call to a material: 16 MB a column."""


@dataclass
class Targets:
    """p* of P conditions as histograms over R x R equal-area cells of the disk.

    The cells are the images of a square grid under the concentric map, so all of them lie
    inside the disk and have area pi / R^2: the rim is neither cut off nor counted twice.
    ``condition`` [P, C]; ``mass`` [P, R, R], each summing to one. Each cell's value is
    taken at one uniformly jittered point, which keeps the mean right for lobes narrower
    than a cell. Conditions without any reflection (black) have no p* and are left out.
    """

    condition: Tensor
    mass: Tensor
    seconds: float
    black: int

    @property
    def resolution(self) -> int:
        """R."""
        return self.mass.shape[-1]

    @classmethod
    def build(cls, material: Material, budget: Budget, generator: torch.Generator) -> Targets:
        """Tabulate p* of ``budget.pool`` random conditions of ``material``.

        The last tables made are kept: methods that fit the same material from the same
        generator state share them.
        """
        key = (id(material), budget.pool, budget.resolution, budget.device)
        seed = int(torch.randint(1 << 62, (), generator=generator))
        if (key, seed) not in _cache:
            start = time.perf_counter()
            own = torch.Generator().manual_seed(seed)
            condition = material.conditions(budget.pool, own, budget.device)
            value = tabulate(material, condition, budget.resolution, own)
            total = value.sum((1, 2), dtype=torch.float64)
            lit = total > 0
            mass = (value[lit] / total[lit, None, None]).float()
            seconds = time.perf_counter() - start
            _cache.clear()
            # The material is kept beside its tables, so that its id stays its own.
            _cache[key, seed] = (
                material,
                cls(condition[lit], mass, seconds, int((~lit).sum())),
            )
        return _cache[key, seed][1]

    def batch(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Conditions [B, C] and directions [B, D, 2] drawn from their p*."""
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        row = row.to(self.mass.device)
        n = self.resolution
        mass = self.mass[row].flatten(1)
        u = torch.rand(conditions, directions, 3, generator=generator).to(mass.device)
        cdf = mass.cumsum(1)
        # Scaled by the cdf's own end, so that rounding leaves no gap above it.
        cell = torch.searchsorted(cdf, u[..., 0] * cdf[:, -1:], right=True)
        cell = cell.clamp(max=n * n - 1)
        corner = torch.stack([cell // n, cell % n], -1)
        return self.condition[row], square_to_disk((corner + u[..., 1:]) / n)

    def uniform(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Conditions [B, C], uniform directions [B, D, 2] of the disk, and p* there [B, D]."""
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        row = row.to(self.mass.device)
        n = self.resolution
        u = torch.rand(conditions, directions, 2, generator=generator).to(self.mass.device)
        cell = (u * n).long()
        cell = cell[..., 0] * n + cell[..., 1]
        density = self.mass[row].flatten(1).gather(1, cell) * (n * n / math.pi)
        return self.condition[row], square_to_disk(u), density

    def mixed(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """As :meth:`uniform`, half of the directions drawn from p*, and weights [B, D].

        The weight is the uniform density over that of the mixture. Weighted means have the
        expectation of :meth:`uniform`'s, with far less noise where p* is narrow.
        """
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        row = row.to(self.mass.device)
        n, half = self.resolution, (directions + 1) // 2
        mass = self.mass[row].flatten(1)
        u = torch.rand(conditions, directions, 3, generator=generator).to(mass.device)
        cdf = mass.cumsum(1)
        cell = torch.searchsorted(cdf, u[:, :half, 0] * cdf[:, -1:], right=True)
        even = (u[:, half:, 0] * (n * n)).long()
        cell = torch.cat([cell, even], 1).clamp(max=n * n - 1)
        relative = mass.gather(1, cell) * (n * n)
        weight = directions / (half * relative + (directions - half))
        corner = torch.stack([cell // n, cell % n], -1)
        wo = square_to_disk((corner + u[..., 1:]) / n)
        return self.condition[row], wo, relative / math.pi, weight


_cache: OrderedDict = OrderedDict()


def cells(resolution: int, jitter: Tensor | None = None, device: str = "cpu") -> Tensor:
    """One point per equal-area cell, [R*R, 2] (or [B, R*R, 2] for ``jitter`` of that shape).

    ``jitter`` in [0, 1)^2 places the point in its cell; its centre by default, and then the
    tensor is shared and not to be written to.
    """
    if jitter is None:
        return _centres(resolution, torch.device(device))
    return square_to_disk((_corners(resolution, device) + jitter) / resolution)


def _corners(resolution: int, device: torch.device | str) -> Tensor:
    index = torch.arange(resolution, device=device, dtype=torch.float32)
    return torch.stack(torch.meshgrid(index, index, indexing="ij"), -1).reshape(-1, 2)


@functools.lru_cache(maxsize=2)
def _centres(resolution: int, device: torch.device) -> Tensor:
    """Of every cell; kept, for at 2048 a side they take longer than most materials."""
    with torch.inference_mode(False):
        return square_to_disk((_corners(resolution, device) + 0.5) / resolution)


def tabulate(
    material: Material,
    condition: Tensor,
    resolution: int,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Target values [N, R, R] at one point per cell: jittered by ``generator``, or the centre."""
    count = resolution * resolution
    device = condition.device
    value = torch.empty(len(condition), count, device=device)
    step = max(1, _ROWS // count)
    for start in range(0, len(condition), step):
        rows = condition[start : start + step]
        jitter = None
        if generator is not None:
            jitter = torch.rand(len(rows), count, 2, generator=generator).to(device)
        wo = cells(resolution, jitter, device)
        value[start : start + step] = material.target_grid(rows, wo.view(-1, count, 2))
    return value.view(-1, resolution, resolution)
