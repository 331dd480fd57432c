"""Materials learned from walks beside a network learned from evaluations, in equal time.

    python -m harness.bench.evaluations MATERIAL [--seconds S]

MATERIAL is a shipped one or a file; the surface is the one that it was learned from. The other
network answers f at two directions and is fitted to path-traced f at random pairs, as NeuMIP's is.
Seconds are this process's processor time, tracing and fitting; by default those that the record of
the material has, which are the wall's. Errors are of both beside the same particles, which neither
was learned from.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from harness.core.protocol.disk import cos_theta, square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials.puresample import storage
from harness.materials.puresample.network import CHANNELS, PureSample
from harness.microgeometry.walks.evaluation import evaluate
from harness.microgeometry.walks.surface import WalkedSurface
from harness.nets.mlp import MLP
from harness.training import kinds
from harness.training.puresample import sources
from harness.training.puresample.quality import CELLS, Held, cell_masses, cell_points

TRACED = 0.3
"""Share of the time in which paths are traced. The rest fits."""
_LANES, _BATCH, _RATE, _FLOOR = 1 << 19, 1 << 13, 5e-3, 0.05


class Reflectance(nn.Module):
    """f at two directions: four hidden layers of 64 on their coordinates, cosines and half vector.

    About as many weights as the density of a material from walks has, and one pass a query.
    """

    def __init__(self) -> None:
        super().__init__()
        self.net = MLP([9, 64, 64, 64, 64, CHANNELS])

    def forward(self, wi: Tensor, wo: Tensor) -> Tensor:
        """[N, 3]; exp(y) - 1 of the network's, at least zero, so that peaks are near to hand."""
        a, b = (torch.cat([v, cos_theta(v)[:, None]], 1) for v in (wi, wo))
        half = nn.functional.normalize(a + b, dim=1)
        return torch.expm1(nn.functional.softplus(self.net(torch.cat([a, b, half], 1))))


def fitted(surface: WalkedSurface, seconds: float, seed: int = 0) -> tuple[Reflectance, int, int]:
    """The network after so many seconds of this process; estimates traced, steps taken."""
    start, random = time.process_time(), torch.Generator().manual_seed(seed)
    parts, block = [], 0
    while not parts or time.process_time() - start < TRACED * seconds:
        u, a, b = torch.rand(_LANES, 6, generator=random).split(2, 1)
        wi, wo = square_to_disk(a), square_to_disk(b)
        f = evaluate(surface, u.contiguous(), wi, wo, seed + (block << 20))
        parts.append((wi, wo, f))
        block += 1
    wi, wo, f = (torch.cat(x) for x in zip(*parts, strict=True))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = Reflectance()
    optimiser = torch.optim.Adam(network.parameters(), lr=_RATE)
    begun, steps = time.process_time(), 0
    rest = max(seconds - (begun - start), 0.0)
    while (done := (time.process_time() - begun) / rest if rest else 1.0) < 1:
        for group in optimiser.param_groups:
            group["lr"] = _RATE * min(1, (steps + 1) / 50) * 0.5 * (1 + math.cos(math.pi * done))
        index = torch.randint(len(f), (_BATCH,), generator=random)
        value = network(wi[index], wo[index])
        # Relative to the answer, whose gradient is stopped: noise in f then moves no mean.
        loss = ((value - f[index]) / (value.detach() + _FLOOR)).square().mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        steps += 1
    return network.eval().requires_grad_(False), len(f), steps


@torch.no_grad()
def from_evaluations(network: Reflectance, wi: Tensor) -> Tensor:
    """Integral [CELLS^2, 3] of f over each cell for light from ``wi`` [2]."""
    at = cell_points()
    flat = at.reshape(-1, 2)
    f = network(wi.expand(len(flat), 2), flat).double()
    return f.view(CELLS**2, -1, CHANNELS).mean(1) * (math.pi / CELLS**2)


@torch.no_grad()
def from_walks(network: PureSample, u: Tensor, wi: Tensor, channel: int) -> Tensor:
    """The same [CELLS^2] of one channel, by density and albedo."""
    albedo = network.albedo(network.features(u[None]), wi[None])[0, channel].double()
    return albedo * cell_masses(network, u, wi, channel, cell_points())[0]


def errors(held: Held, masses: list[Tensor], albedo: Tensor) -> dict[str, float]:
    """KL in nats and relative squared error of f, from ``masses`` [CELLS^2] at each condition, and
    of the albedo [N, 3] at the other directions."""
    kl, squared = [], []
    for mass, count in zip(masses, held.conditions.count, strict=True):
        left = count.sum()
        p, q = count.double() / left, mass / mass.sum()
        met = p > 0
        excess = (int(met.sum()) - 1) / (2 * left)
        kl.append((p[met] * (p[met] / q[met].clamp(min=1e-12)).log()).sum() - excess)
        # Of counts of so many particles; the variance is taken off both squares.
        share, noise = count.double() / WALKS, (count.double() / WALKS**2).sum()
        away = (mass - share).square().sum() - noise
        squared.append(away / (share.square().sum() - noise))
    known = held.survival.share.double()
    relative = (albedo / known - 1)[known > 0]
    return {
        "KL (nats)": float(torch.stack(kl).mean()),
        "relative squared error of f": float(torch.stack(squared).median()),
        "albedo within 3 %": float((relative.abs() < 0.03).double().mean()),
        "albedo off by, 95th percentile": float(relative.abs().quantile(0.95)),
        "mean albedo off by": float(albedo.mean() / known.mean() - 1),
    }


WALKS = 1 << 19
"""Particles from each held-out direction."""


def compared(file: Path, seconds: float | None, seed: int = 1) -> Table:
    """Both, beside particles from 24 directions and albedos at 96."""
    record, network = storage.record(file), storage.load(file)
    surface = sources.of_record(record)
    if not isinstance(surface, WalkedSurface) or network.texture is not None:
        raise InputError(f"{file}: expected a described surface, learned without a texture")
    spent = record["data_seconds"] + record["train_seconds"]
    budget = spent if seconds is None else seconds
    other, traced, steps = fitted(surface, budget, seed)
    held = Held.draw(surface, seed, walks=WALKS)
    at = held.conditions
    by_walks = [
        from_walks(network, u, wi, int(c)) for u, wi, c in zip(at.u, at.wi, at.channel, strict=True)
    ]
    by_evaluations = [
        from_evaluations(other, wi)[:, int(c)] for wi, c in zip(at.wi, at.channel, strict=True)
    ]
    s = held.survival
    own = network.albedo(network.features(s.u), s.wi).detach().double()
    summed = torch.stack([from_evaluations(other, wi).sum(0) for wi in s.wi])
    columns = {
        f"walks, {spent:.0f} s by the wall": errors(held, by_walks, own),
        f"evaluations, {budget:.0f} s of the processor": errors(held, by_evaluations, summed),
    }
    table = Table(
        title=f"{surface.name}: learned from walks, and from evaluations",
        caption=f"{traced:,} evaluations, {steps:,} steps of {_BATCH:,}",
    )
    for name in ("", *columns):
        table.add_column(name, justify="right" if name else "left")
    first, second = columns.values()
    for name in first:
        table.add_row(name, f"{first[name]:.4f}", f"{second[name]:.4f}")
    return table


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("material", help="one learned from walks: a name or a file")
    parser.add_argument("--seconds", type=float, help="of the processor; else as in its record")
    options = parser.parse_args()
    Console(width=110).print(compared(kinds.file_of(options.material), options.seconds))


if __name__ == "__main__":
    main()
