r"""Many histograms in one table: O(1) sampling and lookup of exactly the same density.

Masses are whole numbers of :math:`2^{-32}`-sized units, so the alias method (Walker 1977)
can be set up in integers: the table draws each cell with exactly the probability that the
lookup reports. A cell costs one 32-bit word for drawing and one float for the density.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Float

_BITS = 32


@dataclass(frozen=True)
class AliasTables:
    """``count`` histograms over n x n cells of [-1, 1]^2, flattened one after another.

    ``density`` [count * n * n] float32, per area. ``word`` the same length, int32: the low
    ``alias_bits`` bits are the alias cell, the rest the part of the bin (of ``capacity``)
    that the cell keeps for itself.
    """

    n: int
    alias_bits: int
    density: Tensor
    word: Tensor

    @property
    def capacity(self) -> int:
        """Units in one bin."""
        return 1 << (_BITS - self.alias_bits)

    @classmethod
    def of(cls, mass: Tensor, n: int) -> AliasTables:
        """Tables of ``mass`` [count, n * n] >= 0; zero means that a cell is never drawn."""
        bits = max(1, (n * n - 1).bit_length())
        capacity = 1 << (_BITS - bits)
        whole = whole_units(mass, capacity * n * n)
        keep, alias = split_bins(whole, capacity)
        word = keep * (1 << bits) + alias
        # Words are unsigned; torch has no full support for them, so the bits are kept in int32.
        word = torch.where(word >= 1 << 31, word - (1 << 32), word).int()
        density = (whole.double() / (capacity * 4.0)).float()
        return cls(n, bits, density.flatten(), word.flatten())

    def sample_columns(self, data: Any, which: Any, u: list[Float]) -> tuple[Float, Float]:
        """A point ``(x, y)`` of histogram ``which``; ``data`` from :meth:`columns`.

        ``u[1]`` and ``u[2]`` choose the bin and the place in the cell, ``u[0]`` whether the
        bin's own cell or its alias is taken.
        """
        n, array = self.n, type(u[1])
        index = dr.uint32_array_t(array)
        sx, sy = u[1] * n, u[2] * n
        # u < 1, but u * n may round up to n when n is no power of two.
        ix, iy = dr.minimum(index(sx), n - 1), dr.minimum(index(sy), n - 1)
        fx, fy = sx - array(ix), sy - array(iy)
        cell = iy * n + ix
        word = dr.gather(index, data[1], which * (n * n) + cell)
        own = u[0] * self.capacity < array(word >> self.alias_bits)
        cell = dr.select(own, cell, word & ((1 << self.alias_bits) - 1))
        row = cell // n
        scale = 2 / n
        return (
            dr.fma(array(cell - row * n) + fx, scale, -1),
            dr.fma(array(row) + fy, scale, -1),
        )

    def pdf_columns(self, data: Any, which: Any, x: Float, y: Float) -> Float:
        """Density of histogram ``which`` at ``(x, y)``; zero outside [-1, 1]^2."""
        n, array = self.n, type(x)
        index = dr.uint32_array_t(array)
        # A point of the disk stays in the square under rotation, but for its last bits.
        inside = dr.maximum(dr.abs(x), dr.abs(y)) < 1 + 1e-6
        # Integers bound the index last, for a nan has no place and must not leave the table.
        ix, iy = (
            dr.minimum(index(dr.clip(dr.fma(v, n / 2, n / 2), 0, n - 1)), n - 1) for v in (x, y)
        )
        value = dr.gather(array, data[0], which * (n * n) + iy * n + ix)
        return dr.select(inside, value, 0)

    def columns(self, array: type[Float]) -> tuple[Any, Any]:
        """Both tables as Dr.Jit arrays of the back end of ``array``."""
        index = dr.uint32_array_t(array)
        return array(self.density.numpy()), index(self.word.numpy().view("uint32"))


def whole_units(mass: Tensor, total: int) -> Tensor:
    """``mass`` [..., C] as whole numbers that sum to ``total``, int64.

    Rounded to the nearest; a positive mass gets at least one unit, so that no cell that a
    network calls possible becomes impossible. The few units that are left over or missing
    (at most one a cell) are the largest cell's.
    """
    mass = mass.double()
    scaled = mass / mass.sum(-1, keepdim=True) * total
    whole = torch.where(mass > 0, scaled.round().clamp(min=1), 0).long()
    largest = whole.argmax(-1, keepdim=True)
    return whole.scatter_add(-1, largest, total - whole.sum(-1, keepdim=True))


def split_bins(whole: Tensor, capacity: int) -> tuple[Tensor, Tensor]:
    """Alias bins of ``whole`` [N, C], which sums to ``C * capacity``: ``(keep, alias)``.

    Bin c gives ``keep`` of its units (as compared with ``<``, of ``capacity``) to cell c and
    the rest to ``alias``. Cells that lack units take them from cells in excess, both in
    order, so where each one ends is a search in running sums, for all rows at once.
    """
    cells = torch.arange(whole.shape[-1], device=whole.device).expand_as(whole)
    lack = (capacity - whole).clamp(min=0)
    excess = (whole - capacity).clamp(min=0)
    lacked, exceeded = lack.cumsum(-1), excess.cumsum(-1)
    # A lacking cell is filled by whoever's excess is not used up by the cells before it.
    giver = torch.searchsorted(exceeded, lacked - lack, right=True)
    # A cell in excess gives until it lacks something itself: the next one fills that.
    last = torch.searchsorted(lacked, exceeded).clamp(max=whole.shape[-1] - 1)
    owed = lacked.gather(-1, last) - exceeded
    heir = torch.searchsorted(exceeded, exceeded, right=True)
    rich = excess > 0
    keep = torch.where(rich, capacity - owed, whole)
    alias = torch.where(rich, heir, giver)
    # A full bin is its cell's alone; `capacity` itself does not fit the bits of a word.
    full = keep >= capacity
    alias = torch.where(full, cells, alias)
    return torch.where(full, capacity - 1, keep), alias
