"""Batches of a data base of importance maps, for fitting."""

from __future__ import annotations

import time
from collections import OrderedDict
from pathlib import Path

import torch
from torch import Tensor

from harness.importance_maps.database import BakeSettings, Maps, bake, load
from harness.protocol import Budget, BudgetExceeded, Material

_cache: OrderedDict[tuple, tuple[Material, Maps]] = OrderedDict()


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
        _cache.clear()
        # The material is kept beside its maps, so that its id stays its own.
        _cache[key] = material, made
    return _cache[key][1]


class MapBatches:
    """Random cells of random maps."""

    def __init__(self, maps: Maps, device: str = "cpu"):
        self.condition = maps.condition.to(device)
        self.wo = maps.wo.to(device)
        self.seconds, self.black = maps.seconds, maps.black
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
