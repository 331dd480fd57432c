"""Methods that are one module, learned from baked importance maps."""

from __future__ import annotations

import time
from abc import abstractmethod
from pathlib import Path

import torch
from torch import Tensor

from harness.core.columns.method import ColumnMethod
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, FitReport
from harness.fitting.precision import round_weights
from harness.fitting.steady import ROWS, UNIT, SteadyMethod, moved
from harness.fitting.train import minimise
from harness.importance_maps.database import BakeSettings, Maps
from harness.importance_maps.training import MapBatches, maps_for

UNIFORM_DEVIATION = 12**-0.5
"""Of a uniform number."""
RIM = 2.0**-16
"""So near the rim the disk's chord is shorter than rounding lets it be known, for any state."""


class BakedMethod(SteadyMethod, ColumnMethod):
    """A fit bakes the maps of a material's slices, then learns from cells of them.

    ``slices`` maps are baked, no more than the budget's ``pool``, or read from ``database``, a
    folder that ``harness bake`` made. A subclass builds the module, looks at the conditions once
    (:meth:`meet`) and gives the loss of a batch (:meth:`baked_loss`).
    """

    origin = "its uniforms"
    slices: int
    settings: BakeSettings
    database: Path | None

    def bake_with(self, slices: int, resolution: int, kind: str, database: str) -> None:
        """``slices`` maps of ``resolution``^2 cells of the ``kind``, or those of ``database``."""
        self.slices, self.kind = slices, kind
        self.settings = BakeSettings(kind, resolution, max(64, resolution))
        self.database = Path(database) if database else None

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """See :meth:`Method.fit`."""
        self.material = material
        seed = int(torch.randint(1 << 62, (), generator=generator))
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.module = self.build(material)
        if budget.steps == 0:
            return FitReport()
        maps = maps_for(material, self.settings, self.slices, budget, self.database)
        batches = MapBatches(maps, budget.device)
        self.module.to(budget.device)
        self.meet(batches.condition)
        budget = budget.less(batches.seconds)
        left, start = [budget.steps], time.perf_counter()

        def loss() -> Tensor:
            left[0] -= 1
            share = left[0] / budget.steps
            if budget.seconds:
                share = max(0.0, 1 - (time.perf_counter() - start) / budget.seconds)
            return self.baked_loss(batches, budget, generator, share)

        report = minimise(
            self.module,
            loss,
            batches,
            budget,
            learning_rate=self.learning_rate,
            weight_decay=self.weight_decay,
        )
        round_weights(self.module, self.precision)
        report.notes = self.notes(maps)
        self.refuse_unsteady()
        return report

    @torch.no_grad()
    def unsteady(self) -> float:
        """See :meth:`SteadyMethod.unsteady`: of the map, by the uniforms of its samples.

        Zero where the pdf is a guess: that belongs to no sample in the first place.
        """
        if self.material is None:
            raise RuntimeError(f"{self.name}: used before fit or bind")
        if not self.exact_pdf:
            return 0.0
        generator = torch.Generator().manual_seed(0)
        device = next(self.module.parameters()).device
        condition = self.material.conditions(ROWS, generator, str(device))
        u = torch.rand(ROWS, 3, generator=generator).to(device)
        u[:, 2] = 1 - UNIT  # of the map, not of the uniform share beside it
        wo = self.sample(condition, u).wo.double()
        far = moved(lambda at: self.inverse(condition, at), wo, UNIFORM_DEVIATION)
        return float((far & (wo.norm(dim=1) < 1 - RIM)).double().mean())

    @abstractmethod
    def meet(self, condition: Tensor) -> None:
        """Look at the conditions [P, C] of the maps once before fitting."""

    @abstractmethod
    def baked_loss(
        self, batches: MapBatches, budget: Budget, generator: torch.Generator, left: float
    ) -> Tensor:
        """One batch's loss; ``left`` is the part of the fit still to come, from one to zero."""

    def notes(self, maps: Maps) -> str:
        """What is said of a fit."""
        return f"{len(maps)} importance maps"
