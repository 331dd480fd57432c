"""Where a reflectance is exactly zero, or negative."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from harness.materials.hard.base import DiskMaterial, Made

TILES = 8
"""Texels per side of the checkerboard of :class:`BlackTexels`."""


class BlackTexels(DiskMaterial):
    """A diffuse base and a lobe, times the texel: a checkerboard of exactly 0 and 1.

    A decal, soot, or a texture painted with pure black. One feature, the texel's value. In
    a black texel there is nothing to sample, and f/p, 0/0 and p* all have to be thought of.
    """

    n_features = 1
    BASE, LOBE, SIGMA = 0.3, 0.4, 0.15

    def places(self, uv: Tensor) -> Tensor:
        """See :meth:`Material.places`."""
        tile = (uv * TILES).floor().sum(-1, keepdim=True)
        return tile.remainder(2)

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        off = (wo + 0.5 * condition[..., 1:]) / self.SIGMA
        lobe = torch.exp(-0.5 * off.square().sum(-1)) / (2 * math.pi * self.SIGMA**2)
        return condition[..., 0] * (self.BASE / math.pi + self.LOBE * lobe)

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`; the lobe's share as in :mod:`.lobes`."""
        from scipy.stats import ncx2

        distance = (0.5 * condition[:, 1:].double() / self.SIGMA).square().sum(-1).cpu().numpy()
        share = torch.from_numpy(ncx2.cdf(self.SIGMA**-2, 2, distance))
        return condition[:, 0] * (self.BASE + self.LOBE * share).to(condition)

    def peaks(self, condition: Tensor) -> Tensor:
        """See :meth:`Material.peaks`."""
        return -0.5 * condition[:, None, 1:]


class BlackHemisphere(DiskMaterial):
    """f = 0.8/pi where wo.x <= 0, exactly zero elsewhere: half of the disk is black.

    Slatted blinds, lenticular prints, corduroy brushed one way: what faces away from the
    slats is in their shadow altogether.
    """

    ALBEDO = 0.8

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        value = torch.where(wo[..., 0] <= 0, self.ALBEDO / math.pi, 0).to(wo.dtype)
        return value.expand(torch.broadcast_shapes(condition.shape[:-1], wo.shape[:-1]))

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`."""
        return condition.new_full((len(condition),), self.ALBEDO / 2)


class MeasuredHoles(DiskMaterial):
    """f = 0.25/pi (1 + 2 r^2), with a sector that is exactly zero and one that is negative.

    What an interpolated measurement looks like: no data where the detector shaded the lamp,
    and below zero where the fit overshoots next to it. The sectors turn with wi.
    """

    HOLE = (0.5, 1.2)
    NEGATIVE = (3.0, 3.6)
    DEPTH = -0.2
    """Factor of the negative sector; azimuths in radians, from 2 wi.x on."""

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        turn = torch.atan2(wo[..., 1], wo[..., 0]) - 2 * condition[..., -2]
        turn = turn.remainder(2 * math.pi)
        sign = torch.ones_like(turn)
        sign = torch.where((turn >= self.HOLE[0]) & (turn < self.HOLE[1]), 0, sign)
        negative = (turn >= self.NEGATIVE[0]) & (turn < self.NEGATIVE[1])
        sign = torch.where(negative, self.DEPTH, sign)
        return sign * (0.25 / math.pi) * (1 + 2 * wo.square().sum(-1))

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`: of |f|, half of what the sectors let pass."""
        hole = self.HOLE[1] - self.HOLE[0]
        negative = self.NEGATIVE[1] - self.NEGATIVE[0]
        share = 1 - (hole + (1 - abs(self.DEPTH)) * negative) / (2 * math.pi)
        return condition.new_full((len(condition),), 0.5 * share)


_HERE = Path(__file__)
MATERIALS = {
    "black-texels": Made("half of the texels are exactly black", _HERE, BlackTexels),
    "black-hemisphere": Made("exactly black for half of all directions", _HERE, BlackHemisphere),
    "measured-holes": Made("negative and missing sectors, as measured", _HERE, MeasuredHoles),
}
