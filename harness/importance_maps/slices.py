"""One slice of a BSDF: what it reflects from one direction, on a grid over the projected disk."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.core.protocol.disk import REC709, inside_disk
from harness.core.protocol.material import Material
from harness.nets.squares import Squares

STRATA = 4
"""Points per side of a cell, for materials that do not make slices themselves."""
_ROWS = 1 << 21
"""Evaluations of a material at a time."""


@dataclass(frozen=True)
class Slice:
    """Mean BSDF (no cosine) of the R x R cells of [-1, 1]^2: ``rgb`` [R, R, 3], row y, column x.

    A cell that the rim cuts has the mean over the whole cell, zero off the disk. The density
    is the luminance (absolute, as :meth:`Material.target`), taken as constant
    over each cell's part inside the disk.
    """

    rgb: NDArray[np.float64]

    @property
    def resolution(self) -> int:
        """R."""
        return len(self.rgb)

    @functools.cached_property
    def mass(self) -> NDArray[np.float64]:
        """Probability [R, R] of each cell; sums to one.

        Raises:
            ValueError: the slice is black and has no density.
        """
        value = np.abs(self.rgb @ np.asarray(REC709))
        # What Monte Carlo found where the disk is not would be a mistake of the material.
        value = np.where(inner_share(self.resolution) > 0, value, 0)
        total = value.sum()
        if not total > 0:
            raise ValueError("a black slice has no density")
        return value / total

    @functools.cached_property
    def density(self) -> NDArray[np.float64]:
        """Probability [R, R] per disk area, over each cell's part inside the disk."""
        share = inner_share(self.resolution)
        area = share * (2 / self.resolution) ** 2
        return np.divide(self.mass, area, out=np.zeros_like(area), where=share > 0)

    def cell(self, wo: NDArray) -> tuple[NDArray, NDArray]:
        """Row and column of the cell that holds each of ``wo`` [..., 2] of [-1, 1]^2."""
        at = ((wo + 1) * (self.resolution / 2)).astype(int)
        # The far edge belongs to the last cell.
        at = np.clip(at, 0, self.resolution - 1)
        return at[..., 1], at[..., 0]

    def weight(self, wo: NDArray) -> NDArray:
        r"""Sampling weight f / p [..., 3] at ``wo`` [..., 2], from the cell it lies in.

        Both per disk area; with p in proportion to the luminance of f it is the albedo times
        the colour, hence of low frequency (the paper's Figure 7).
        """
        row, column = self.cell(wo)
        share = inner_share(self.resolution)[row, column]
        density = self.density[row, column]
        lit = density > 0
        # Where the density is zero no sample comes to be weighed: the cell is black.
        scale = np.where(lit, 1 / np.where(lit, density * share, 1), 0)
        return self.rgb[row, column] * scale[..., None]

    @functools.cached_property
    def spread(self) -> float:
        r"""Effective share of the disk, :math:`1 / (\pi \int p^2\,dA)`: 1 for the uniform disk."""
        return float(1 / (np.pi * (self.mass * self.density).sum()))


@functools.cache
def inner_share(resolution: int) -> NDArray[np.float64]:
    """Part [R, R] of each cell that lies inside the disk, 0 to 1."""
    squares = Squares.covering(resolution)
    grid = squares.spread(squares.share).view(resolution, resolution)
    return grid.double().numpy()


def slices_of(material: Material, condition: Tensor, resolution: int, seed: int) -> Tensor:
    """Slices [N, R, R, 3] of ``material`` at ``condition`` [N, C], as :class:`Slice` has them.

    A material with ``slices`` of its own (a parametric family) makes them. Others are
    evaluated at ``STRATA``^2 jittered points per cell; a row's points do not depend on the
    other rows of the call.
    """
    if callable(getattr(material, "slices", None)):
        return material.slices(condition, resolution, seed)
    count = resolution * STRATA
    generator = torch.Generator().manual_seed(seed)
    jitter = torch.rand(count, count, 2, generator=generator)
    corner = torch.stack(torch.meshgrid(*[torch.arange(count)] * 2, indexing="xy"), -1)
    points = ((corner + jitter) * (2 / count) - 1).view(-1, 2).to(condition.device)
    inside = inside_disk(points)
    found = condition.new_zeros(len(condition), count * count, 3)
    within = points[inside]
    step = max(1, _ROWS // len(within))
    for start in range(0, len(condition), step):
        rows = condition[start : start + step]
        many = rows.repeat_interleave(len(within), 0)
        value = material.eval(many, within.repeat(len(rows), 1))
        found[start : start + step, inside] = value.view(len(rows), -1, 3)
    blocks = found.view(-1, resolution, STRATA, resolution, STRATA, 3)
    return blocks.mean((2, 4))
