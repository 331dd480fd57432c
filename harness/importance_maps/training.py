"""Batches of a data base of importance maps, for fitting."""

from __future__ import annotations

import time
from collections import OrderedDict
from pathlib import Path

import torch
from torch import Tensor

from harness.core.protocol.disk import luminance, square_to_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.importance_maps.database import BakeSettings, Maps, bake, load
from harness.importance_maps.slices import inner_share

_cache: OrderedDict[tuple, tuple[Material, Maps]] = OrderedDict()
_KEPT = 2
"""Data bases kept in memory: two kinds of map of one material."""


def maps_for(
    material: Material,
    settings: BakeSettings,
    slices: int,
    budget: Budget,
    database: Path | None = None,
) -> Maps:
    """``slices`` maps of ``material``, at most ``budget.pool``; from ``database`` if there is one.

    The last ones made are kept: variants of a method that fit the same material share them.

    Raises:
        InputError: the data base is not there, or not of this material.
        BudgetExceeded: ``budget.max_seconds`` passed.
    """
    count = min(slices, budget.pool)
    if database is not None:
        return load(database, material, count)
    key = (id(material), settings, count, budget.device)
    if key not in _cache:
        deadline = time.perf_counter() + budget.max_seconds
        try:
            made = bake(material, settings, count, device=budget.device, deadline=deadline)
        except TimeoutError as late:
            raise BudgetExceeded(
                f"fit passed its limit of {budget.max_seconds:g} s: {late}"
            ) from None
        while len(_cache) >= _KEPT:
            _cache.popitem(last=False)
        # The material is kept beside its maps, so that its id stays its own.
        _cache[key] = material, made
    return _cache[key][1]


class MapBatches:
    """Random cells of random maps."""

    def __init__(self, maps: Maps, device: str = "cpu"):
        self.condition = maps.condition.to(device)
        self.wo = maps.wo.to(device)
        self.seconds = maps.seconds
        self.notes = f"{maps.black} black conditions left out" if maps.black else ""
        share = torch.from_numpy(inner_share(maps.rgb.shape[1])).float().flatten()
        # What is off the disk is never asked for.
        self._share = torch.where(share > 0, share, 1).to(device)
        self._rgb, self._scale = maps.rgb.to(device), maps.scale.to(device).flatten(1)

    def draw(
        self, conditions: int, directions: int, generator: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Conditions [B, C], uniforms and directions [B, D, 2] of cells, and rows [B] of maps."""
        device, n = self.wo.device, self.wo.shape[1]
        row = torch.randint(len(self.condition), (conditions,), generator=generator).to(device)
        cell = torch.randint(n * n, (conditions, directions), generator=generator).to(device)
        wo = self.wo[row].flatten(1, 2).gather(1, cell[..., None].expand(-1, -1, 2))
        u = torch.stack([cell % n, cell // n], -1)
        return self.condition[row], (u + 0.5) / n, wo, row

    def at(self, row: Tensor, wo: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """f [B, D, 3], weight f / p [B, D, 3] and p [B, D] of maps ``row`` [B] at ``wo`` [B, D, 2].

        From the cell of the slice that each direction lies in, per disk area.
        """
        n = self._rgb.shape[1]
        cell = ((wo + 1) * (n / 2)).long().clamp(0, n - 1)
        index = cell[..., 1] * n + cell[..., 0]
        rgb = self._rgb.flatten(1, 2)
        mean = rgb[row].float()
        # Means over cells that the rim cuts are of their part inside the disk.
        value = mean.gather(1, index[..., None].expand(-1, -1, 3)) * self._scale[row][..., None]
        value = value / self._share[index][..., None]
        total = luminance(mean).abs().sum(1) * self._scale[row][:, 0] * (2 / n) ** 2
        pdf = luminance(value).abs() / total[:, None]
        # Where the density is zero, so is f, and its weight.
        weight = value / torch.where(pdf > 0, pdf, 1)[..., None]
        return value, weight, pdf

    def half_even(self, wo: Tensor, generator: torch.Generator) -> Tensor:
        """``wo`` [B, D, 2] with the second half of the directions replaced by uniform ones."""
        b, d, _ = wo.shape
        even = square_to_disk(torch.rand(b, d - d // 2, 2, generator=generator)).to(wo)
        return torch.cat([wo[:, : d // 2], even], 1)
