"""How well a trained material answers: error and energy, against the path-traced truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import luminance
from harness.materials.neural import textures
from harness.materials.neural.network import NeuralMBTF
from harness.microgeometry import queries

_ROWS = 1 << 17


@dataclass(frozen=True)
class Quality:
    """Errors on held-out queries.

    ``r2`` of log(1 + f) over all channels, and ``r2_error``, its standard error over the queries:
    a few at grazing angles weigh most; ``mse`` of f; ``energy_error`` the 95th percentile,
    over conditions (u, wi), of the relative error of the energy reflected under constant light,
    the integral of f over the disk (luminance); ``energy_within`` the share of conditions with
    less than 5 %; ``energy_bias`` of the mean energy. ``energy_noise`` is the 95th percentile
    of the relative standard error of that difference: energies are known no better than this.
    """

    r2: float
    r2_error: float
    mse: float
    energy_error: float
    energy_within: float
    energy_bias: float
    energy_noise: float

    def as_dict(self) -> dict[str, float]:
        """As JSON data."""
        return asdict(self)


class Energies(NamedTuple):
    """Conditions, the energies known there, and directions to integrate a network over."""

    u: Tensor
    """[N, 2]"""
    kernel: Tensor
    """[N]"""
    wi: Tensor
    """[N, 2]"""
    energy: Tensor
    """Luminance [N] of the integral of f over the disk."""
    error: Tensor
    """Its standard error [N]."""
    wo: Tensor
    """[N, side^2, 2], one in each cell of equal area."""


@dataclass(frozen=True)
class Held:
    """Truth at places and directions that no training draws; made once, compared with any network.

    ``single`` are queries of many paths.
    """

    single: queries.Queries
    energy: Energies

    @classmethod
    def draw(
        cls,
        surface: Any,
        seed: int,
        kernel: float | tuple[float, float],
        rows: int = 1 << 18,
        samples: int = 256,
        conditions: int = 1024,
        paths: int = 1 << 15,
        side: int = 160,
        device: str = "cpu",
    ) -> Held:
        """``rows`` queries of ``samples`` paths; ``conditions`` of ``paths`` and side^2 lights."""
        single = queries.draw(surface, rows, seed + (1 << 40), kernel, samples, device=device)
        u, sigma, wi = queries.draw(
            surface, conditions, seed + (2 << 40), kernel, 1, device=device
        )[:3]
        found, error = queries.energy(surface, u, sigma, wi, paths, seed + (3 << 40), device=device)
        wo = queries.stratified(conditions, side, seed).to(device)
        # Of sums, a standard error is at most the sum of standard errors.
        return cls(single, Energies(u, sigma, wi, luminance(found), luminance(error), wo))

    def measure(self, network: NeuralMBTF) -> Quality:
        """The errors of ``network``."""
        truth, found = self.single.f, answer(network, self.single)
        log_truth, log_found = truth.clamp(min=0).log1p().double(), found.log1p().double()
        spread = (log_truth - log_truth.mean(0)).square().sum(1)
        missed = (log_truth - log_found).square().sum(1)
        unexplained = missed.sum() / spread.sum()
        energy = self.energy.energy.double()
        ours, integration = (luminance(x).double() for x in energies(network, self.energy))
        relative = (ours / energy - 1).abs()
        noise = torch.hypot(self.energy.error.double(), integration) / energy
        return Quality(
            r2=float(1 - unexplained),
            # Of a ratio of sums over independent queries, to first order.
            r2_error=float((missed - unexplained * spread).square().sum().sqrt() / spread.sum()),
            mse=float((truth - found).square().mean()),
            energy_error=float(relative.quantile(0.95)),
            energy_within=float((relative < 0.05).double().mean()),
            energy_bias=float(ours.mean() / energy.mean() - 1),
            energy_noise=float(noise.quantile(0.95)),
        )


def footprints(network: NeuralMBTF) -> float | tuple[float, float]:
    """Footprints a network is for: half a texel, or the range of its pyramid's levels."""
    a = network.architecture
    finest = textures.kernel_of(0, a.resolution)
    return (finest, textures.kernel_of(a.levels - 1, a.resolution)) if a.pyramid else finest


@torch.no_grad()
def answer(network: NeuralMBTF, asked: queries.Queries) -> Tensor:
    """Reflectance [N, 3] of the network at queries, a slice at a time."""
    a = network.architecture
    parts = []
    for first in range(0, len(asked.u), _ROWS):
        u, kernel, wi, wo = (x[first : first + _ROWS] for x in asked[:4])
        level = textures.level_of(kernel, a.resolution) if a.pyramid else None
        parts.append(network.reflectance(network.features(u, wi, level), wi, wo))
    return torch.cat(parts)


@torch.no_grad()
def energies(network: NeuralMBTF, asked: Energies) -> tuple[Tensor, Tensor]:
    """Integrals [N, 3] of the network over the disk, and their standard errors."""
    a = network.architecture
    level = textures.level_of(asked.kernel, a.resolution) if a.pyramid else None
    features = network.features(asked.u, asked.wi, level)
    parts = []
    for one, wi, wo in zip(features, asked.wi, asked.wo, strict=True):
        f = network.reflectance(one.expand(len(wo), -1), wi.expand(len(wo), -1), wo)
        parts.append(queries.integral(f[None]))
    return tuple(torch.cat(x) for x in zip(*parts, strict=True))
