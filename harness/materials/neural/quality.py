"""How well a trained material answers: error and energy, against the path-traced truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from harness.materials.neural import textures
from harness.materials.neural.network import NeuralMBTF
from harness.microgeometry import queries
from harness.protocol import luminance, square_to_disk

_ROWS = 1 << 17


@dataclass(frozen=True)
class Quality:
    """Errors on held-out queries.

    ``r2`` of log(1 + f) over all channels; ``mse`` of f; ``energy_error`` the 95th percentile,
    over conditions (u, wi), of the relative error of the energy reflected under constant light,
    the integral of f over the disk (luminance); ``energy_within`` the share of conditions with
    less than 5 %; ``energy_bias`` of the mean energy. ``energy_noise`` is the 95th percentile
    of the relative standard error of that difference: energies are known no better than this.
    """

    r2: float
    mse: float
    energy_error: float
    energy_within: float
    energy_bias: float
    energy_noise: float

    def as_dict(self) -> dict[str, float]:
        """As JSON data."""
        return asdict(self)


@dataclass(frozen=True)
class Held:
    """Truth that no training of a small seed has seen; made once, compared with any network.

    ``single`` are queries of many paths. ``energy`` are queries of one path, ``directions``
    a condition, condition after condition.
    """

    single: queries.Queries
    energy: queries.Queries
    directions: int

    @classmethod
    def draw(
        cls,
        surface: Any,
        seed: int,
        kernel: float | tuple[float, float],
        rows: int = 1 << 15,
        samples: int = 64,
        conditions: int = 256,
        directions: int = 2048,
        device: str = "cpu",
    ) -> Held:
        """``rows`` single queries of ``samples`` paths, ``conditions`` x ``directions`` of one."""
        single = queries.draw(surface, rows, seed + (1 << 40), kernel, samples, device=device)
        drawn = queries.draw(surface, conditions, seed + (2 << 40), kernel, 1, device=device)
        u, sigma, wi = (x.repeat_interleave(directions, 0) for x in drawn[:3])
        generator = torch.Generator().manual_seed(seed)
        wo = square_to_disk(torch.rand(conditions * directions, 2, generator=generator)).to(device)
        f = queries.truth(surface, u, sigma, wi, wo, 1, seed + (3 << 40), device=device)
        return cls(single, queries.Queries(u, sigma, wi, wo, f), directions)

    def measure(self, network: NeuralMBTF) -> Quality:
        """The errors of ``network``."""
        truth, found = self.single.f, answer(network, self.single)
        log_truth, log_found = truth.clamp(min=0).log1p().double(), found.log1p().double()
        spread = (log_truth - log_truth.mean(0)).square().sum()
        # One and the same directions in both, so that their choice is no part of the difference.
        light, ours = (
            luminance(f).double().view(-1, self.directions)
            for f in (self.energy.f, answer(network, self.energy))
        )
        energy, error = light.mean(1), (light - ours).std(1) / self.directions**0.5
        relative = (ours.mean(1) / energy - 1).abs()
        return Quality(
            r2=float(1 - (log_truth - log_found).square().sum() / spread),
            mse=float((truth - found).square().mean()),
            energy_error=float(relative.quantile(0.95)),
            energy_within=float((relative < 0.05).double().mean()),
            energy_bias=float(ours.mean() / energy.mean() - 1),
            energy_noise=float((error / energy).quantile(0.95)),
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
