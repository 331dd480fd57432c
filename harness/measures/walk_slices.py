"""Where light goes at a few angles: by a material learned from walks, and by the walks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field

from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.materials.puresample.material import PureSampleMaterial
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.walks import albedo_of, conditions, source_of
from harness.training.puresample.preview import latent

CELLS = 48
"""A side of the grid of cells of equal area."""
GRAZING = 0.95
"""Sine of the last angle."""
_CHANNELS = 3
_TEXTURE = 96
"""Pixels of the picture of a latent texture."""
_PIXELS = 120
"""Pixels a side of the picture that cells are shown in."""


class WalkSlices(Measure):
    """f over the disk at ``angles`` of incidence whose sines go evenly from 0 to 0.95.

    All in the plane of ``azimuth``. ``walks`` particles a channel and angle are counted in cells of
    48^2; the material's f is evaluated at ``side``^2 points of each. Where it varies over its
    surface all is the mean over ``places`` places, the walks' starts among them. The method plays
    no part. ``kl-0``, ... are of the particles' directions to the learned density, the mean over
    channels, with what counts add by chance taken off.
    """

    name = "walk-slices"
    needs_scene = False

    class Settings(BaseSettings):
        """See the class."""

        angles: Annotated[int, Field(ge=1)] = 3
        azimuth: float = 20.0
        walks: Annotated[int, Field(ge=1)] = 1 << 20
        places: Annotated[int, Field(ge=1)] = 16
        side: Annotated[int, Field(ge=1)] = 2

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        material, random = job.material, job.generator
        source = source_of(material)
        turn = math.radians(settings.azimuth)
        sine = torch.linspace(0, GRAZING, settings.angles)
        wi = sine[:, None] * torch.tensor([math.cos(turn), math.sin(turn)])
        many = settings.places if material.n_features else 1
        places = torch.rand(many, 2, generator=random)
        count, mass, learned = [], [], []
        for i, at in enumerate(wi):
            notify(f"angle {i + 1} of {settings.angles}")
            starts = places if material.n_features else None
            count.append(counted(source, at, starts, settings.walks, job.seed + 1000 * i, random))
            rows = conditions(material, at, places)
            mass.append(evaluated(material, rows, settings.side))
            learned.append(albedo_of(material, rows, mass[-1]))
        arrays = {
            "wi": single(wi.numpy()),
            "walks": np.array(settings.walks),
            "count": np.stack(count).astype(np.int32),
            "mass": single(np.stack(mass)),
            "learned": np.stack(learned),
            "raster": raster(),
        }
        if isinstance(material, PureSampleMaterial) and material.network.texture is not None:
            arrays["latent"] = single(latent(material.network, _TEXTURE))
        return Outcome(arrays=arrays)


def counted(
    source: Any,
    wi: torch.Tensor,
    places: torch.Tensor | None,
    n: int,
    seed: int,
    random: torch.Generator,
) -> np.ndarray:
    """How many of ``n`` particles a channel leave into each cell [3, CELLS^2].

    They start at ``places`` [P, 2] in turn, or anywhere in the tile.
    """
    found = []
    for channel in range(_CHANNELS):
        if places is None:
            u = torch.rand(n, 2, generator=random)
        else:
            u = places.repeat(-(-n // len(places)), 1)[:n]
        exits = source.walk(
            u, wi.expand(n, 2).contiguous(), torch.full((n,), channel), seed + channel
        )
        index = _cell_of(exits.wo[exits.left].double().cpu())
        found.append(torch.bincount(index, minlength=CELLS**2).numpy())
    return np.stack(found)


def raster() -> np.ndarray:
    """The cell of each pixel [120, 120] of a picture of the disk, its first row on top; -1 off."""
    at = (torch.arange(_PIXELS) + 0.5) / _PIXELS * 2 - 1
    y, x = torch.meshgrid(at.flip(0), at, indexing="ij")
    wo = torch.stack([x, y], -1).view(-1, 2).double()
    inside = wo.square().sum(1) < 1
    cell = torch.where(inside, _cell_of(torch.where(inside[:, None], wo, 0)), -1)
    return cell.view(_PIXELS, _PIXELS).numpy().astype(np.int16)


def _cell_of(wo: torch.Tensor) -> torch.Tensor:
    # Rounding may put a point of the rim beyond its cells.
    cell = (disk_to_square(wo) * CELLS).long().clamp(0, CELLS - 1)
    return cell[:, 0] * CELLS + cell[:, 1]


def evaluated(material: Any, rows: torch.Tensor, side: int) -> np.ndarray:
    """Integral [3, CELLS^2] of f over each cell, the mean over rows [P, C]."""
    at = (torch.arange(CELLS * side) + 0.5) / (CELLS * side)
    wo = square_to_disk(torch.cartesian_prod(at, at))
    total = torch.zeros(len(wo), _CHANNELS, dtype=torch.float64)
    for row in rows:
        total += material.eval(row.expand(len(wo), -1).contiguous(), wo).double() / len(rows)
    cells = total.view(CELLS, side, CELLS, side, _CHANNELS).mean((1, 3))
    return (cells.view(-1, _CHANNELS).T * (math.pi / CELLS**2)).numpy()
