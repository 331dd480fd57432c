"""How well a trained material answers, beside walks that no training drew."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.core.streams import generator
from harness.materials.puresample.network import CHANNELS, PureSample
from harness.training.puresample import albedo
from harness.training.puresample.albedo import Survival

CELLS = 48
"""A side of the grid of equal areas on which densities are compared."""
_POINTS = 4
"""Directions in each cell at which the network's density is asked for."""
_HELD, _DIRECTIONS, _PLACES = (k << 40 for k in (11, 12, 13))
"""Between a training's seed and those of what is held out from it."""


@dataclass(frozen=True)
class Quality:
    """``kl``: mean over held-out conditions (direction, channel) of KL(walks || network) in nats,
    in cells of 48^2, less the mean excess that counts of so many walks have by chance; ``kl_error``
    its standard error over conditions, ``kl_worst`` the largest. ``lost``: share of the directions
    asked for that have no density, since a step of the flow is not one to one there: f is not a
    number, and nor is any divergence then. ``albedo_within``: share of
    directions and channels whose albedo is within 3 % of the walks'; ``albedo_error``: 95th
    percentile of the relative difference, ``albedo_noise`` that of the walks' standard error;
    ``albedo_bias``: of the mean albedo, relative."""

    kl: float
    kl_error: float
    kl_worst: float
    lost: float
    albedo_within: float
    albedo_error: float
    albedo_noise: float
    albedo_bias: float

    def as_dict(self) -> dict[str, float]:
        """As JSON data."""
        return asdict(self)


class Conditions(NamedTuple):
    """Held-out conditions and how often walks from them left into each cell."""

    u: Tensor
    """[N, 2]"""
    wi: Tensor
    """[N, 2]"""
    channel: Tensor
    """[N]"""
    count: Tensor
    """[N, CELLS^2]"""


@dataclass(frozen=True)
class Held:
    """Truth that no training drew; made once, compared with any network."""

    conditions: Conditions
    survival: Survival

    @classmethod
    def draw(
        cls,
        source: Any,
        seed: int,
        textured: bool = False,
        conditions: int = 24,
        walks: int = 1 << 19,
        directions: int = 96,
        group: int = 1 << 18,
        device: str = "cpu",
    ) -> Held:
        """``walks`` particles from each of the conditions, ``group`` a channel of each direction.

        Without a texture each particle has its own place, with one all of a condition share theirs.
        """
        random = generator(seed + _HELD)
        u = torch.rand(conditions, 2, generator=random)
        wi = square_to_disk(torch.rand(conditions, 2, generator=random))
        channel = torch.arange(conditions) % CHANNELS
        counts = []
        for i in range(conditions):
            n = walks
            here = u[i].expand(n, 2) if textured else torch.rand(n, 2, generator=random)
            rows = wi[i].expand(n, 2).contiguous()
            of = channel[i].expand(n).contiguous()
            found = source.walk(here.contiguous(), rows, of, seed + _HELD + i, device)
            inside = found.wo[found.left].cpu()
            counts.append(torch.bincount(_cell(inside), minlength=CELLS**2))
        random = generator(seed + _DIRECTIONS)
        at = square_to_disk(torch.rand(directions, 2, generator=random))
        places = torch.rand(directions, 2, generator=random)
        survival = albedo.at(source, places, at, group, seed + _PLACES, device, not textured)
        return cls(Conditions(u, wi, channel, torch.stack(counts)), survival)

    @torch.no_grad()
    def measure(self, network: PureSample) -> Quality:
        """The errors of ``network``, which is on the CPU."""
        kl, lost = divergences(network, self.conditions)
        s = self.survival
        known, error = s.share.double(), s.error.double()
        found = network.albedo(network.features(s.u), s.wi).double()
        # Where no particle came back there is no relative error.
        some = known > 0
        relative = ((found - known).abs() / known)[some]
        return Quality(
            kl=float(kl.mean()),
            kl_error=float(kl.std() / math.sqrt(len(kl))),
            kl_worst=float(kl.max()),
            lost=float(lost.mean()),
            albedo_within=float((relative < 0.03).double().mean()),
            albedo_error=float(relative.quantile(0.95)),
            albedo_noise=float((error / known)[some].quantile(0.95)),
            albedo_bias=float(found.mean() / known.mean() - 1),
        )


def divergences(network: PureSample, held: Conditions) -> tuple[Tensor, Tensor]:
    """KL(walks || network) [N] in nats in cells; unbiased to first order in 1 / walks. And the
    share [N] of directions without a density: where there are any, the KL is not a number.

    The mean excess of an estimate from counts, (cells - 1) / (2 n) with those cells that were met
    (Miller 1955), is taken off. Cells blur what is narrower than they are, 0.04 of the radius.
    """
    at = cell_points()
    found, lost = [], []
    for u, wi, channel, count in zip(*held, strict=True):
        p = count.double() / count.sum()
        q, none = cell_masses(network, u, wi, int(channel), at)
        lost.append(none)
        met = p > 0
        kl = (p[met] * (p[met] / q[met]).log()).sum() if none == 0 else p.new_tensor(math.nan)
        found.append(kl - (int(met.sum()) - 1) / (2 * count.sum()))
    return torch.stack(found), torch.stack(lost)


def cell_points() -> Tensor:
    """Directions [CELLS^2, _POINTS, 2], stratified in each cell."""
    index = torch.arange(CELLS)
    corner = torch.stack(torch.meshgrid(index, index, indexing="ij"), -1).view(-1, 1, 2)
    half = torch.tensor([[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])
    return square_to_disk((corner + half) / CELLS)


def cell_masses(
    network: PureSample, u: Tensor, wi: Tensor, channel: int, at: Tensor
) -> tuple[Tensor, Tensor]:
    """Probability [CELLS^2] that the network gives each cell, by its density at the points that
    have one (none: zero), and the share of points that have none."""
    flat, parts = at.reshape(-1, 2), []
    features = network.features(u[None])
    for wo in flat.split(1 << 12):
        n = len(wo)
        of = torch.full((n,), channel)
        log = network.log_density(features.expand(n, -1), of, wi.expand(n, 2), wo)
        parts.append(log.double().exp())
    density = torch.cat(parts).view(CELLS**2, -1)
    there = ~density.isnan()
    mean = torch.where(there, density, 0).sum(1) / there.sum(1).clamp(min=1)
    return mean * (math.pi / CELLS**2), 1 - there.double().mean()


def _cell(wo: Tensor) -> Tensor:
    square = (disk_to_square(wo.double()) * CELLS).long().clamp(0, CELLS - 1)
    return square[:, 0] * CELLS + square[:, 1]
