"""How close a learned material comes to walks through its surface: energy, shape, reciprocity."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.core.protocol.errors import InputError, Unsupported
from harness.materials.neural.material import NeuralMaterial
from harness.materials.puresample.material import PureSampleMaterial
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.training.puresample import sources

CELLS = 12
"""A side of the grid of cells of equal area in which f is compared."""
_POINTS = 12
"""A side of the raster of points of a cell at which the material is evaluated: with 4, a narrow
peak of `bronze-grains` lost 2 % of its energy."""
_CHANNELS = 3

Learned = PureSampleMaterial | NeuralMaterial


class Walks(Measure):
    """The albedo and f of a material beside particles that walk through its microgeometry.

    At ``angles`` cosines of wi, evenly spaced, and ``azimuths`` of each, ``walks`` particles a
    channel start at random places. How many leave is an estimate of the albedo with a binomial
    error, and where they leave one of the integral of f over the 12^2 cells of the disk, whose
    noise is known and taken off the difference. The material says its albedo itself; its f is
    evaluated at 12^2 points a cell, at one random place for each of ``places`` where it varies. A
    neural material, learned from evaluations, has the albedo that its f has over those points.

    Reciprocity: f(wi, wo) and f(wo, wi) at ``pairs`` of directions uniform on the disk. The
    geometry is reciprocal in the mean over its tile; the material is not by construction. The
    method plays no part.
    """

    name = "walks"
    needs_scene = False

    class Settings(BaseSettings):
        """See the class."""

        angles: int = 8
        azimuths: int = 2
        walks: int = 1 << 17
        pairs: int = 4096
        places: int = 16

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        material, random = job.material, job.generator
        source = source_of(material)
        cosine = (torch.arange(settings.angles) + 0.5) / settings.angles
        left, count, learned, mass = [], [], [], []
        for i, z in enumerate(cosine):
            notify(f"cosine {float(z):.2f}")
            turn = 2 * math.pi * torch.rand(settings.azimuths, generator=random)
            sine = torch.sqrt(1 - z * z)
            for k, wi in enumerate(sine * torch.stack([turn.cos(), turn.sin()], 1)):
                seed = job.seed + (1 + i * settings.azimuths + k) * 1000
                seen = walked(source, wi, settings.walks, seed, random)
                left.append(seen.sum(1))
                count.append(seen)
                many = settings.places if material.n_features else 1
                rows = conditions(material, wi, torch.rand(many, 2, generator=random))
                mass.append(evaluated(material, rows))
                learned.append(albedo_of(material, rows, mass[-1]))
        f = reciprocal(material, settings.pairs, random)
        shape = (settings.angles, settings.azimuths)
        return Outcome(
            arrays={
                "cosine": single(cosine.numpy()),
                "walks": np.array(settings.walks),
                "left": np.stack(left).reshape(*shape, _CHANNELS),
                "count": np.stack(count).reshape(*shape, _CHANNELS, CELLS**2).astype(np.int32),
                "learned": np.stack(learned).reshape(*shape, _CHANNELS),
                "mass": single(np.stack(mass).reshape(*shape, _CHANNELS, CELLS**2)),
                "pairs": single(f),
                "size_bytes": np.array(size_bytes(material)),
            }
        )


def walked(source: Any, wi: torch.Tensor, n: int, seed: int, random: torch.Generator) -> np.ndarray:
    """How many of ``n`` particles of each channel leave into each cell: [3, CELLS^2]."""
    found = []
    for channel in range(_CHANNELS):
        u = torch.rand(n, 2, generator=random)
        rows, of = wi.expand(n, 2).contiguous(), torch.full((n,), channel)
        exits = source.walk(u, rows, of, seed + channel)
        square = disk_to_square(exits.wo[exits.left].double().cpu()) * CELLS
        cell = square.long().clamp(0, CELLS - 1)
        index = cell[:, 0] * CELLS + cell[:, 1]
        found.append(torch.bincount(index, minlength=CELLS**2).numpy())
    return np.stack(found)


def conditions(material: Learned, wi: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
    """Rows [P, C] of the material at places ``uv`` [P, 2] and directions [P, 2] or [2]."""
    wi = wi.expand(len(uv), 2)
    if isinstance(material, NeuralMaterial):
        return material.condition_at(uv, wi.contiguous())
    return torch.cat([material.places(uv), wi], 1)


def albedo_of(material: Learned, rows: torch.Tensor, mass: np.ndarray) -> np.ndarray:
    """Mean albedo [3] over rows [P, C]: as the material says it, or the sum [3, cells] of f."""
    if isinstance(material, NeuralMaterial):
        return mass.sum(1)
    return material.albedo(rows).double().mean(0).numpy()


def evaluated(material: Learned, rows: torch.Tensor) -> np.ndarray:
    """Integral [3, CELLS^2] of the material's f over each cell, in the mean over rows [P, C]."""
    side = CELLS * _POINTS
    at = (torch.arange(side) + 0.5) / side
    wo = square_to_disk(torch.cartesian_prod(at, at))
    total = 0.0
    for row in rows:
        f = material.eval(row.expand(len(wo), -1).contiguous(), wo)
        total = total + f.double() / len(rows)
    cells = total.view(CELLS, _POINTS, CELLS, _POINTS, _CHANNELS).mean((1, 3))
    return (cells.view(-1, _CHANNELS).T * (math.pi / CELLS**2)).numpy()


def reciprocal(material: Learned, n: int, random: torch.Generator) -> np.ndarray:
    """f [n, 2, 3] at random pairs of directions, one way and the other."""
    u = torch.rand(n, 6, generator=random)
    a, b = (square_to_disk(u[:, k : k + 2]) for k in (0, 2))
    rows = [conditions(material, x, u[:, 4:]) for x in (a, b)]
    ways = [material.eval(row, y) for row, y in zip(rows, (b, a), strict=True)]
    return torch.stack(ways, 1).numpy()


def size_bytes(material: Learned) -> int:
    """Of the tensors as they are stored: textures in half precision."""
    tensors = material.network.state_dict().items()
    return sum(v.numel() * (2 if "texture" in name else v.element_size()) for name, v in tensors)


def source_of(material: Any) -> Any:
    """The surface that a material was learned from, to walk on.

    A neural material was learned from evaluations of a relief, on which particles walk as well.

    Raises:
        Unsupported: it was not learned, or its surface is not known or has changed.
    """
    if not isinstance(material, PureSampleMaterial | NeuralMaterial) or (
        not {"name", "description"} <= set(material.record)
    ):
        raise Unsupported(f"material '{material.name}' has no record of walks or evaluations")
    try:
        return sources.of_record(material.record)
    except InputError as error:
        name = material.record["name"]
        raise Unsupported(f"material '{material.name}', learned from '{name}': {error}") from None
