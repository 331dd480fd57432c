"""Pictures of the density beside its target, for chosen conditions (NeuSample's Figure 7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

import numpy as np
import torch
from pydantic import Field

from harness.core.protocol.disk import inside_disk
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.densities import checked_density


class Slices(Measure):
    """p* and p on a regular grid of [-1, 1]^2, nan off the disk, and directions the method draws.

    The conditions are the same for all methods of a material. Both densities are taken at
    cell centres; p* is normalised over the grid, p is shown as the method gives it.
    """

    name = "slices"
    needs_scene = False

    class Settings(BaseSettings):
        """``count`` conditions on a ``grid`` x ``grid`` raster; ``samples`` points of each."""

        count: int = 3
        grid: int = 128
        samples: Annotated[int, Field(ge=0)] = 300

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings)) for job in jobs]

    def _one(self, job: Job, settings: Settings) -> Outcome:
        n = settings.grid
        condition = job.material.conditions(settings.count, job.generator, job.budget.device)
        axis = (torch.arange(n, device=condition.device) + 0.5) * (2 / n) - 1
        wo = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1).reshape(-1, 2)
        wo = wo[inside_disk(wo)]
        rows = condition.repeat_interleave(len(wo), 0)
        points = wo.repeat(settings.count, 1)
        shape = (settings.count, len(wo))
        area = (2 / n) ** 2
        value = job.material.target_grid(condition, wo[None]).double()
        target = (value / (value.sum(1, keepdim=True) * area)).cpu().numpy()
        pdf = checked_density(job.method.pdf(rows, points), job.method)
        pdf = pdf.view(shape).double().cpu().numpy()
        column = ((wo + 1) * (n / 2)).long().cpu().numpy()
        arrays = {"condition": condition.cpu().numpy()}
        for name, density in (("target", target), ("pdf", pdf)):
            image = np.full((settings.count, n, n), math.nan)
            image[:, column[:, 1], column[:, 0]] = density
            arrays[name] = single(image)
        arrays["samples"] = self._samples(job, condition, settings.samples)
        return Outcome(arrays=arrays)

    @staticmethod
    def _samples(job: Job, condition: torch.Tensor, count: int) -> np.ndarray:
        """Directions [K, count, 2] drawn by the method; some may lie off the disk."""
        rows = condition.repeat_interleave(count, 0)
        u = torch.rand(len(rows), 3, generator=job.generator).to(condition)
        wo = job.method.sample(rows, u).wo
        return single(wo.view(len(condition), count, 2).double().cpu().numpy())
