"""Constants, and a constant with one bright pixel."""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from harness.materials.hard.base import DiskMaterial, Made


class Constant(DiskMaterial):
    """f = 1/pi: a white Lambertian surface, the target that has no structure at all.

    Chalk or fresh snow. A uniform sampler is exact for it; whatever a method adds is its own.
    """

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        shape = torch.broadcast_shapes(condition.shape[:-1], wo.shape[:-1])
        return wo.new_full(shape, 1 / math.pi)

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`."""
        return condition.new_ones(len(condition))


class BrightPixel(DiskMaterial):
    """f = 0.001, and 10,000 more in one square cell 1/512 wide, which holds 92 % of the energy.

    A firefly in a measured table: a saturated or stray sample of the photometer that nobody
    removed. The cell is a millionth of the disk and lies on no grid of a method's own.
    """

    BASE, BRIGHT, WIDTH = 1e-3, 1e4, 2.0**-9
    # On a lattice of single precision, so that the cell has exactly its width.
    CORNER = (round(0.3712 * 2**20) / 2**20, round(-0.2291 * 2**20) / 2**20)

    def factor(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.factor`."""
        place = (wo - wo.new_tensor(self.CORNER)) / self.WIDTH
        bright = ((place >= 0) & (place < 1)).all(-1)
        value = torch.where(bright, self.BASE + self.BRIGHT, self.BASE).to(wo.dtype)
        return value.expand(torch.broadcast_shapes(condition.shape[:-1], wo.shape[:-1]))

    def albedo(self, condition: Tensor) -> Tensor:
        """See :meth:`DiskMaterial.albedo`."""
        whole = self.BASE * math.pi + self.BRIGHT * self.WIDTH**2
        return condition.new_full((len(condition),), whole)

    def peaks(self, condition: Tensor) -> Tensor:
        """See :meth:`Material.peaks`."""
        centre = condition.new_tensor(self.CORNER) + self.WIDTH / 2
        return centre.expand(len(condition), 1, 2)


_HERE = Path(__file__)
MATERIALS = {
    "constant": Made("f = 1/pi", _HERE, Constant),
    "bright-pixel": Made("92 % of the energy in a millionth of the disk", _HERE, BrightPixel),
}
