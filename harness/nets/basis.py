"""A network that holds a family of histograms, and the histograms it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from harness.nets.encoding import sinusoids
from harness.nets.mlp import MLP
from harness.nets.squares import Squares


class BasisHistograms(nn.Module):
    """K densities on the disk, each a family over a latent code ``t`` in [0, 1].

    A network of (x, y, t), encoded by sines and cosines of frequency 2^l pi, l < 4 (27
    numbers), with K outputs through softplus. A share ``uniform`` of every density is spread
    evenly over the disk: softplus of a network falls below the least single-precision number
    where nothing was seen, and p > 0 is owed wherever f > 0.
    """

    def __init__(self, count: int, width: int, layers: int, uniform: float, frequencies: int = 4):
        super().__init__()
        self.count, self.uniform, self.frequencies = count, uniform, frequencies
        inputs = 3 * (1 + 2 * frequencies)
        self.mlp = MLP([inputs, *[width] * layers, count])

    def log_value(self, point: Tensor, t: Tensor) -> Tensor:
        """Log of the unnormalised densities, [L, M, K], at ``point`` [M, 2] and ``t`` [L]."""
        # sin and cos of 2^l pi x: the encoding of pi x, whose first entry is then pi x as well.
        xy, code = (sinusoids(math.pi * v, self.frequencies) for v in (point, t[:, None]))
        levels, points = len(t), len(point)
        raw = self.mlp(
            torch.cat([xy.expand(levels, -1, -1), code[:, None].expand(-1, points, -1)], -1)
        )
        # softplus(x) is exp(x) to seven digits below -15, where its logarithm would be lost.
        return torch.where(raw < -15, raw, nn.functional.softplus(raw.clamp(min=-15)).log())

    def density(self, squares: Squares, t: Tensor) -> Tensor:
        """Densities [L, M, K] of the cells or tents, integrating to one over the disk."""
        log = self.log_value(squares.point, t)
        area = (squares.share * squares.width**2)[:, None]
        log = log - torch.logsumexp(log + area.log(), 1, keepdim=True)
        return (1 - self.uniform) * log.exp() + self.uniform / math.pi


@dataclass(frozen=True)
class Volume:
    """Densities tabulated on a lattice of (t, y, x), to be interpolated: [K, L, n, n].

    Level i is at ``first_level + i * level_width``; cells as in ``squares``. The network is
    run once a lattice point instead of once a basis, condition and direction, which is what
    makes its fit affordable. The lattice is moved at random between steps (:meth:`random`),
    so the network learns everywhere and not on one lattice only.
    """

    table: Tensor
    squares: Squares
    first_level: float
    level_width: float

    @classmethod
    def random(
        cls, basis: BasisHistograms, levels: int, n: int, generator: torch.Generator
    ) -> Volume:
        """A lattice of ``levels`` x ``n`` x ``n``, shifted by up to its pitch."""
        device = next(basis.parameters()).device
        shift, level_shift = torch.rand(2, generator=generator).tolist()
        squares = Squares.tents(n, shift, device)
        pitch = 1 / (levels - 2)
        first = -level_shift * pitch
        t = first + pitch * torch.arange(levels, device=device)
        table = squares.spread(basis.density(squares, t).permute(2, 0, 1))
        return cls(table.unflatten(-1, (n, n)), squares, first, pitch)

    def at(self, local: Tensor, t: Tensor) -> Tensor:
        """Densities [B, D, K] at ``local`` [B, D, K, 2] and ``t`` [B, K], trilinear.

        Their integral over the disk is one, like that of the tents they are made of.
        """
        _, levels, n, _ = self.table.shape
        xy = 2 * (local - self.squares.first) / (self.squares.width * (n - 1)) - 1
        z = 2 * (t - self.first_level) / (self.level_width * (levels - 1)) - 1
        z = z[:, None].expand(local.shape[:-1])
        grid = torch.cat([xy, z[..., None]], -1).permute(2, 0, 1, 3)[:, None]
        value = nn.functional.grid_sample(
            self.table[:, None], grid, padding_mode="border", align_corners=True
        )
        return value[:, 0, 0].permute(1, 2, 0)
