"""Directions drawn from the target density p*, for a pool of conditions."""

from __future__ import annotations

import functools
import math
import time
from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.fitting.quadtree import Quadtree

_ROWS = 1 << 22
"""Target evaluations per call to a material: 16 MB a column."""
_AT_A_TIME = 1 << 18
"""Cells or directions in hand while directions are drawn: what is not kept stays small."""
LOOK = 32
"""Cells a side of the first look at p*."""
DIRECTIONS = 1024
"""Drawn for each condition, at the least."""


@dataclass
class Targets:
    r"""p* of P conditions as N weighted directions each, with its true value at them.

    ``condition`` [P, C]; ``wo`` [P, N, 2] inside the disk; ``density`` [P, N] is p* at them per
    disk area, from the material itself; ``area`` [P, N] the part of the disk that each stands for,
    so that :math:`\int g \approx \sum_i a_i g(\omega_i)` without bias. ``density`` is scaled so
    that ``mass``, their product, sums to one.

    The directions are drawn where p* is (:mod:`harness.fitting.quadtree`), and drawing them again
    in proportion to ``mass`` (sampling-importance resampling, Rubin 1987) gives directions of p*
    itself: no cell blurs a peak, however narrow it is. Conditions without any reflection (black)
    have no p* and are left out, and so are those where f is no number.
    """

    condition: Tensor
    wo: Tensor
    density: Tensor
    area: Tensor
    seconds: float
    black: int = 0
    broken: int = 0

    @property
    def mass(self) -> Tensor:
        """[P, N]: with what probability a direction is drawn again."""
        return self.density * self.area

    @property
    def notes(self) -> str:
        """What was left out, and why; empty if nothing."""
        said = []
        if self.black:
            said.append(f"{self.black} black conditions left out")
        if self.broken:
            said.append(f"{self.broken} conditions left out where f is not finite")
        return "; ".join(said)

    @classmethod
    def build(cls, material: Material, budget: Budget, generator: torch.Generator) -> Targets:
        """Draw for ``budget.pool`` random conditions of ``material``.

        The last ones made are kept: methods that fit the same material from the same generator
        state share them.

        Raises:
            InputError: no condition of the pool reflects anything.
        """
        count = max(DIRECTIONS, 4 * budget.directions)
        key = (id(material), budget.pool, count, budget.device)
        seed = int(torch.randint(1 << 62, (), generator=generator))
        if (key, seed) not in _cache:
            start = time.perf_counter()
            own = torch.Generator().manual_seed(seed)
            condition = material.conditions(budget.pool, own, budget.device)
            found = []
            for rows in condition.split(max(1, _AT_A_TIME // count)):
                found.append(quadrature(material, rows, count, own))
            wo, value, area = (torch.cat(parts) for parts in zip(*found, strict=True))
            mass = value * area
            whole = mass.isfinite().all(1)
            total = torch.where(whole, mass.sum(1, dtype=torch.float64), 0)
            lit = total > 0
            broken = int((~whole).sum())
            black = int((~lit).sum()) - broken
            if not lit.any():
                raise InputError(
                    f"material '{material.name}': in none of {budget.pool} conditions is light"
                    f" reflected ({black} are black, in {broken} f is not finite); expected some"
                )
            density = (value[lit] / total[lit, None]).float()
            seconds = time.perf_counter() - start
            _cache.clear()
            # The material is kept beside its directions, so that its id stays its own.
            _cache[key, seed] = (
                material,
                cls(condition[lit], wo[lit], density, area[lit], seconds, black, broken),
            )
        return _cache[key, seed][1]

    def batch(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Conditions [B, C] and directions [B, D, 2] drawn from their p*.

        Stratified: one of D equal parts of a condition's mass for each of its directions.
        """
        row = self._rows(conditions, generator)
        which = resampled(self.density[row] * self.area[row], directions, generator)
        return self.condition[row], self.wo[row].gather(1, pair(which))

    def mixed(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Conditions [B, C], directions [B, D, 2], p* there [B, D] and weights [B, D].

        Half of the directions are drawn from p*, half uniformly. The weight is the uniform density
        over that of the mixture: weighted means have the expectation of uniform directions, with
        far less noise where p* is narrow.
        """
        row, half = self._rows(conditions, generator), (directions + 1) // 2
        density, area = self.density[row], self.area[row]
        which = torch.cat(
            [
                resampled(density * area, half, generator),
                resampled(area, directions - half, generator),
            ],
            1,
        )
        density = density.gather(1, which)
        weight = directions / (half * density * math.pi + (directions - half))
        return self.condition[row], self.wo[row].gather(1, pair(which)), density, weight

    def _rows(self, conditions: int, generator: torch.Generator) -> Tensor:
        row = torch.randint(len(self.condition), (conditions,), generator=generator)
        return row.to(self.wo.device)


_cache: OrderedDict = OrderedDict()


def quadrature(
    material: Material, condition: Tensor, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """``count`` directions [N, M, 2], target there [N, M] and area of the disk [N, M].

    Four in five where the target is (:class:`~harness.fitting.quadtree.Quadtree`), the others
    uniform; the area is what each direction stands for, so that sums over them of area times any
    function have the expectation of its integral over the disk. The target is as the material gives
    it, not normalised, without a cosine.
    """

    def target(point: Tensor) -> Tensor:
        return material.target_grid(condition, square_to_disk(point))

    mirrored = -condition[:, None, -2:]
    peaks = torch.cat([mirrored, material.peaks(condition)], 1)
    tree = Quadtree.build(target, len(condition), LOOK, disk_to_square(peaks), generator)
    point, area = tree.draw(count, generator)
    wo = square_to_disk(point)
    return wo, material.target_grid(condition, wo), area * math.pi


def resampled(mass: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Columns [B, ``count``] of ``mass`` [B, N], each drawn in proportion to it; stratified."""
    u = torch.rand(len(mass), count, generator=generator).to(mass.device)
    u = (torch.arange(count, device=mass.device) + u) / count
    cdf = mass.cumsum(1)
    # Scaled by the cdf's own end, so that rounding leaves no gap above it.
    return torch.searchsorted(cdf, u * cdf[:, -1:], right=True).clamp(max=mass.shape[1] - 1)


def pair(which: Tensor) -> Tensor:
    """Columns [B, D] as an index [B, D, 2] of directions."""
    return which[..., None].expand(-1, -1, 2)


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
