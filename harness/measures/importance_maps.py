"""How smooth importance maps are, and what bilinear interpolation makes of them (Figure 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
import torch
from pydantic import Field

from harness.core.protocol.errors import Unsupported
from harness.importance_maps.baked_method import BakedMethod
from harness.importance_maps.maps import ImportanceMap, make_map
from harness.importance_maps.quality import binned_error, coarse, gradients, histogram, stratified
from harness.importance_maps.slices import Slice, slices_of
from harness.importance_maps.transport import grid
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.stats.chisquare import chi_square

METRICS = ("binned-error", "gradient-mean", "gradient-p99", "cost", "evenness")
_BINS = 16
"""Cells a side in which the points of a map are counted."""


class ImportanceMaps(Measure):
    r"""Maps of random slices, of the kind that the method bakes, at each resolution R.

    - ``binned-error-R``: share of the probability in wrong cells after bilinear interpolation;
    - ``gradient-mean-R``, ``gradient-p99-R``: mean and 99th percentile of
      :math:`\lVert \partial\omega / \partial\xi \rVert_F` over the map;
    - ``cost-R``: mean squared distance from the scaled grid, what optimal transport minimises;
    - ``evenness-R``: chi-square of the map's points against the slice, per degree of freedom:
      1 for independent samples, less for points that are spread more evenly.

    Means over slices with their intervals; per slice in the arrays, with ``spread``, the
    effective share of the disk (1: uniform), by which tables tell broad lobes from narrow.
    The conditions, and so the slices, are the same for all methods of a material.
    """

    name = "importance-maps"
    needs_scene = False

    class Settings(BaseSettings):
        """``count`` slices of ``slice_resolution``^2 cells; ``shown`` of them are kept as images.

        ``bins``^2 cells for the interpolation error, with ``side``^2 stratified points.
        """

        count: Annotated[int, Field(ge=2)] = 24
        slice_resolution: Annotated[int, Field(ge=16)] = 128
        resolutions: Annotated[list[int], Field(min_length=1)] = [16, 32, 64, 128]
        bins: int = 32
        side: int = 512
        shown: int = 2

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        if not isinstance(job.method, BakedMethod):
            raise Unsupported(f"{job.method.name} bakes no importance maps")
        kind = job.method.kind
        condition = job.material.conditions(settings.count, job.generator, job.budget.device)
        seed = int(torch.randint(1 << 30, (), generator=job.generator))
        rgb = slices_of(job.material, condition, settings.slice_resolution, seed).double().cpu()
        lit = rgb.abs().sum((1, 2, 3)) > 0
        slices = [Slice(one.numpy()) for one in rgb[lit]]
        found: dict[str, list[list[float]]] = {name: [] for name in METRICS}
        shown: dict[str, list] = {"map": [], "binned": [], "target": []}
        for k, slice_ in enumerate(slices):
            notify(f"{job.material.name}: {kind} maps {k + 1}/{len(slices)}")
            maps = [make_map(slice_, n, kind) for n in settings.resolutions]
            rows = [_measured(map_, slice_, settings) for map_ in maps]
            for name, values in zip(METRICS, zip(*rows, strict=True), strict=True):
                found[name].append(list(values))
            if k < settings.shown:
                points = maps[-1].at(stratified(settings.side, 0))
                shown["map"].append(maps[-1].wo.astype(np.float32))
                shown["binned"].append(histogram(points, settings.bins * 2).astype(np.float32))
                shown["target"].append(coarse(slice_.mass, settings.bins * 2).astype(np.float32))
        arrays = {name.replace("-", "_"): single(values) for name, values in found.items()}
        arrays |= {name: np.array(images) for name, images in shown.items()}
        arrays["spread"] = single([s.spread for s in slices])
        arrays["resolutions"] = np.array(settings.resolutions)
        arrays["condition"] = condition.cpu()[lit].numpy()
        return Outcome(arrays=arrays)


def _measured(
    map_: ImportanceMap, slice_: Slice, settings: ImportanceMaps.Settings
) -> tuple[float, ...]:
    """In the order of :data:`METRICS`."""
    slope, wo = gradients(map_), map_.wo.reshape(-1, 2)
    test = chi_square(histogram(wo, _BINS) * len(wo), coarse(slice_.mass, _BINS) * len(wo))
    return (
        binned_error(map_, slice_, settings.bins, settings.side),
        float(slope.mean()),
        float(np.quantile(slope, 0.99)),
        float(np.square(grid(map_.resolution) - wo).sum(1).mean()),
        # Of a lobe within one cell there is nothing to be compared.
        test.statistic / test.dof if test.dof else 0.0,
    )
