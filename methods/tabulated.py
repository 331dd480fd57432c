"""The ceiling: the target density itself, tabulated for every row that is asked for."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, inside_disk, square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Knob, Method
from harness.fitting.targets import tabulate

_CELLS = 1 << 22
"""Cells tabulated at a time: 16 MB of values, 32 MB of sums."""


class Tabulated(Method):
    r"""p* of each condition row on R x R equal-area cells of the disk, sampled by inversion.

    The brute-force reference of Xu et al. (2023, NeuSample, Fig. 10), at their R = 2048 by
    default: near-optimal, and impractical, for each row costs R^2 evaluations of the material.
    With :math:`f_{ij}` the target at the centre of cell (i, j) of the concentric grid and
    :math:`\varepsilon` = ``defensive``, per disk area:

    .. math:: p_\perp(\omega \in ij) = \frac{R^2}{\pi}\left[(1 - \varepsilon)
              \frac{f_{ij}}{\sum f} + \frac{\varepsilon}{R^2}\right]

    A share :math:`\varepsilon` of the uniform disk is mixed in because a cell whose centre is
    black may be lit elsewhere: without it p = 0 < f there, and that energy is never found.
    The price is at most a share :math:`\varepsilon` of the samples. 0 is allowed and gives
    p* as tabulated. A row whose table is all zero is sampled uniformly, and has that density.

    The inverse is that of the marginal over i, then of the conditional over j, both
    continuous: two uniforms, and the remainder of each places the point in its cell. Every
    sample is valid. Nothing is fitted or stored. Rows with the same condition as the row
    before share its table; the sums of the last batch are kept, so that ``pdf`` after
    ``sample`` costs one evaluation per row.
    """

    name = "tabulated"
    uniforms = 2
    knobs: ClassVar[tuple[Knob, ...]] = (
        Knob("resolution", (8, 16, 32, 64, 128, 512, 2048), "cells a side of each row's table"),
    )

    def __init__(self, resolution: int = 2048, defensive: float = 2**-7):
        if resolution < 1:
            raise InputError(f"tabulated: resolution is {resolution}; expected at least 1")
        if not 0 <= defensive < 1:
            raise InputError(f"tabulated: defensive is {defensive}; expected 0 <= defensive < 1")
        self.resolution, self.defensive = resolution, defensive
        self._last: tuple[Tensor, Tensor] | None = None

    def bind(self, material: Material) -> None:
        """See :meth:`Method.bind`."""
        super().bind(material)
        self._last = None

    def rebound(self, material: Material) -> Tabulated:
        """See :meth:`Method.rebound`; tables of the other material are forgotten."""
        other = super().rebound(material)
        other._last = None
        return other

    @torch.no_grad()
    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor | None:
        """See :meth:`Method.reference_pdf`: cells and sums in double, the material as it is."""
        distinct, group = _runs(condition.float())
        total = torch.cat(
            [self._table(distinct[rows]).double().sum((1, 2)) for rows in self._chunks(distinct)]
        )
        return self._density(condition.float(), wo.double(), total[group])

    @torch.no_grad()
    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        # Other precisions are answered as the numbers they hold, as the tables are in single.
        condition, u = condition.float(), u.float()
        distinct, group = _runs(condition)
        wo = condition.new_empty(len(condition), 2)
        total = condition.new_empty(len(distinct), dtype=torch.float64)
        for rows in self._chunks(distinct):
            table = self._table(distinct[rows])
            total[rows] = table.sum((1, 2), dtype=torch.float64)
            weights = self._weights(table, total[rows, None, None])
            here = torch.searchsorted(group, torch.tensor([rows.start, rows.stop], device=u.device))
            mine = slice(*here.tolist())
            wo[mine] = self._invert(weights, group[mine] - rows.start, u[mine])
        self._last = (distinct, total)
        return DiskSample(wo, self._density(condition, wo, total[group]))

    @torch.no_grad()
    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        condition, wo = condition.float(), wo.float()
        distinct, group = _runs(condition)
        return self._density(condition, wo, self._totals(distinct)[group])

    def _totals(self, distinct: Tensor) -> Tensor:
        """Sum of each row's table, [N] in double precision."""
        if self._last is not None:
            known, total = self._last
            if known.device == distinct.device and torch.equal(known, distinct):
                return total
        total = distinct.new_empty(len(distinct), dtype=torch.float64)
        for rows in self._chunks(distinct):
            total[rows] = self._table(distinct[rows]).sum((1, 2), dtype=torch.float64)
        self._last = (distinct, total)
        return total

    def _chunks(self, condition: Tensor) -> list[slice]:
        """Slices of rows whose tables fit the memory set aside for them."""
        step = max(1, _CELLS // self.resolution**2)
        n = len(condition)
        return [slice(i, min(i + step, n)) for i in range(0, n, step)]

    def _table(self, condition: Tensor) -> Tensor:
        """Target at the centres of the cells, [N, R, R]."""
        if self.material is None:
            raise RuntimeError(f"{self.name}: used before fit or bind")
        return tabulate(self.material, condition, self.resolution)

    def _weights(self, value: Tensor, total: Tensor) -> Tensor:
        """Cell weights that sum to R^2 over a table, from values and the table's sum."""
        black = total == 0
        scaled = value * (self.resolution**2 / torch.where(black, 1, total)).to(value.dtype)
        return torch.where(black, 1, (1 - self.defensive) * scaled + self.defensive)

    def _invert(self, weight: Tensor, table: Tensor, u: Tensor) -> Tensor:
        """Points of the disk [N, 2] from ``weight[table]``, tables [T, R, R] and indices [N]."""
        i, a = _invert(weight.sum(2), table, u[:, 0])
        # Only rows that are wanted, each once: a batch of one condition shares them.
        rows, mine = torch.unique(table * self.resolution + i, return_inverse=True)
        j, b = _invert(weight.flatten(0, 1)[rows], mine, u[:, 1])
        return square_to_disk(torch.stack([i + a, j + b], -1) / self.resolution).to(u.dtype)

    def _density(self, condition: Tensor, wo: Tensor, total: Tensor) -> Tensor:
        """Density [N] at ``wo``, from the target at the centre of the cell it lies in."""
        n = self.resolution
        inside = inside_disk(wo)
        # Off the disk there is no cell: any will do, its density is replaced by zero. The
        # square's closed edge belongs to the last cell.
        point = torch.where(inside[:, None], wo, 0).double()
        cell = (disk_to_square(point) * n).long().clamp(0, n - 1)
        centre = square_to_disk((cell.to(wo.dtype) + 0.5) / n)
        weight = self._weights(self.material.target(condition, centre), total)
        return torch.where(inside, weight / math.pi, 0).to(wo.dtype)


def _runs(condition: Tensor) -> tuple[Tensor, Tensor]:
    """Conditions without repeats in a row [T, C], and which of them each row is [N].

    Whoever asks for many directions of one condition has one table made for them.
    """
    if len(condition) == 0:
        return condition.clone(), condition.new_empty(0, dtype=torch.long)
    return torch.unique_consecutive(condition, dim=0, return_inverse=True)


def _invert(mass: Tensor, row: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Cell and place in it, [N] each, where the cdf of ``mass[row]`` reaches ``u`` [N].

    ``mass`` is [M, R], ``row`` [N] indexes it.
    """
    cdf, width = mass.double().cumsum(1).flatten(), mass.shape[1]
    first = row * width
    target = u.double() * cdf.index_select(0, first + (width - 1))
    # u < 1, so the target is below the cdf's end and the cell found has mass. A row of nan
    # compares with nothing; any cell of it has a density of nan.
    cell = torch.zeros_like(row)
    for step in (2**k for k in reversed(range((width - 1).bit_length()))):
        ahead = cell + step
        passed = cdf.index_select(0, first + (ahead - 1).clamp(max=width - 1)) <= target
        cell = torch.where(passed & (ahead < width), ahead, cell)
    own = mass.flatten().index_select(0, first + cell).double()
    return cell, 1 - (cdf.index_select(0, first + cell) - target) / own
