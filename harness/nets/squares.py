r"""Square cells laid over the projected disk.

Histograms live on n x n square cells of :math:`[-1, 1]^2`. Cells wholly outside the disk
carry nothing, for f = 0 there. A cell on the rim is kept whole, so what is drawn in its
outer part is an invalid sample; ``share`` says how much of it is of use.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_SUB = 32
"""Points a side at which a cell on the rim is tested for being inside the disk."""


@dataclass(frozen=True)
class Squares:
    """The cells, out of ``n`` x ``n`` of width ``width``, that reach into the disk.

    Cell ``iy * n + ix`` has its centre at ``first + width * (ix, iy)``. ``index`` [M] are
    the kept cells, ``share`` [M] in (0, 1] the part of each that is inside, ``point`` [M, 2]
    its centre, moved inwards onto the rim where the centre itself is off the disk: a network
    need not be asked for values where there are no data.

    A *tent* is a cell that reaches to its neighbours' centres, weighted linearly down to
    nothing there; its ``share`` is that of its weight. Values times tents are bilinear
    interpolation, and ``share * width**2`` is what a value adds to the integral over the disk.
    """

    n: int
    width: float
    first: float
    index: Tensor
    share: Tensor
    point: Tensor

    @classmethod
    def covering(cls, n: int, device: torch.device | str = "cpu") -> Squares:
        """``n`` x ``n`` cells that tile [-1, 1]^2."""
        return cls.of(n, 2 / n, -1 + 1 / n, False, device)

    @classmethod
    def tents(cls, n: int, shift: float, device: torch.device | str = "cpu") -> Squares:
        """``n`` x ``n`` tents that span [-1, 1]^2 for any ``shift`` in [0, 1] of a width."""
        width = 2 / (n - 2)
        return cls.of(n, width, -1 - shift * width, True, device)

    @classmethod
    def of(
        cls, n: int, width: float, first: float, tent: bool, device: torch.device | str
    ) -> Squares:
        """Cells or tents of any place and width."""
        centre = first + width * torch.arange(n, device=device, dtype=torch.float64)
        y, x = torch.meshgrid(centre, centre, indexing="ij")
        reach = width if tent else width / 2
        near = (x.abs() - reach).clamp(min=0).square() + (y.abs() - reach).clamp(min=0).square()
        # A tie on the rim keeps a cell: rounding may put a point of the disk there.
        keep = (near <= 1 + 1e-12).flatten()
        point = torch.stack([x, y], -1).view(-1, 2)[keep]
        share = torch.ones_like(point[:, 0])
        rim = (point.abs() + reach).square().sum(-1) > 1
        step = ((torch.arange(_SUB, device=device, dtype=point.dtype) + 0.5) / _SUB * 2 - 1) * reach
        weight = 1 - step.abs() / reach if tent else torch.ones_like(step)
        weight = weight / weight.sum()
        at = point[rim]
        inside = (
            (at[:, None, None, 0] + step).square() + (at[:, None, None, 1] + step[:, None]).square()
        ) < 1
        part = (inside * weight * weight[:, None]).sum((1, 2))
        # What meets the disk in less than a test point counts as half of the lightest.
        share[rim] = part.clamp(min=0.5 * float(weight.min()) ** 2)
        point = point / point.norm(dim=-1, keepdim=True).clamp(min=1)
        return cls(n, width, first, keep.nonzero()[:, 0], share.float(), point.float())

    def spread(self, value: Tensor) -> Tensor:
        """Values of the kept cells [..., M] on the whole grid [..., n * n], 0 elsewhere."""
        out = value.new_zeros(*value.shape[:-1], self.n * self.n)
        return out.index_copy(-1, self.index, value)
