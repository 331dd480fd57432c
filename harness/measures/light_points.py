r"""Points of an image under constant light and directions at them, the same for every method.

What a method's variance is largest at cannot be known without the method; but most of it comes from
where f is. So f alone decides about points c (rows) and directions: a first look at every pixel
says how many rows it gets, a second how the disk of each is divided, a third what is in each leaf
(:mod:`harness.measures.light_cells`). Then directions are drawn over all rows and leaves at once.
At row c and direction :math:`\omega` there are on average

.. math:: r(c, \omega) = \frac{t(c, leaf)}{area} + b(c)\, q(\omega | c)

of them per area of the disk, with the leaves' counts t and b of a
:class:`~harness.rendering.broad.Broad` sampler q, which goes to peaks narrower than a leaf.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.core.protocol.disk import inside_disk, luminance
from harness.core.protocol.material import Material
from harness.core.streams import generator
from harness.measures import light_cells as cells
from harness.rendering import seen
from harness.rendering.broad import Broad
from harness.rendering.prepared import Prepared

LOOKS = 4
"""Points of a pixel in the first look."""
EXTRA = 0.5
"""Rows that a pixel gets beyond one in each set, on average."""
NEAR = 32
"""Directions of the broad sampler in the looks at a row."""
PEAKS = 4
"""Leaves of a row that a method's density is asked at first."""
_SHARES = {"even": 0.1, "first": 0.2, "second": 0.2, "square": 0.2, "broad": 0.3}
_ROWS = 1 << 19
_BROAD = Broad()


@dataclass(frozen=True)
class Half:
    """Rows of one half: two sets that share nothing, and directions at them.

    ``condition`` [N, C], ``pixel`` [N] in ascending order, ``set`` [N] 0 or 1, ``share`` [N] one
    over the rows of the pixel; ``albedo`` [2, N] twice, independent and unbiased. ``value``
    [N, LEAVES] is about |f| in each leaf, ``table`` [N, LEAVES] and ``near`` [N] are t and b. The
    directions, ascending by row: ``row`` [M], ``wo`` [M, 2], luminance ``f`` [M], ``rate`` [M].
    ``peak_leaf`` and ``peak_f`` [N, PEAKS] with ``peak_wo`` [N, PEAKS, 2] are where f^2 is largest.
    """

    pixels: int
    condition: Tensor
    pixel: Tensor
    set: Tensor
    share: Tensor
    albedo: Tensor
    leaves: cells.Leaves
    value: Tensor
    table: Tensor
    near: Tensor
    row: Tensor
    wo: Tensor
    f: Tensor
    rate: Tensor
    peak_leaf: Tensor
    peak_f: Tensor
    peak_wo: Tensor

    def rates(self, row: Tensor, leaf: Tensor, wo: Tensor) -> Tensor:
        """r [M] at directions ``wo`` [M, 2], in ``leaf`` [M], of ``row`` [M]."""
        area = cells.areas(wo.device)
        return _rates(self.condition, self.table / area, self.near, row, leaf, wo)


def draw(
    prepared: Prepared, material: Material, pixels: NDArray, directions: int, seed: int
) -> Half:
    """Of ``pixels`` [P, 2], with ``directions`` of them on average in all."""
    stream = generator(seed)
    rng = np.random.default_rng(seed)
    of_set = _rows_of(prepared, material, pixels, rng, stream)
    condition, pixel, part = _points(prepared, pixels, of_set, rng)
    device = condition.device
    share = (1 / (2 * torch.from_numpy(of_set)))[pixel].to(device)
    pixel, part = pixel.to(device), part.to(device)
    area = cells.areas(device)

    _, square = _look(material, condition, stream)
    total = square.sum(1, keepdim=True)
    # A neighbour of a cell with a peak has a part of it.
    score = square + cells.spread(square, cells.COARSE) + total * 1e-6
    leaves = cells.Leaves.of(score)
    twice = torch.stack([_in_leaves(material, condition, leaves, stream) for _ in range(2)])
    value = _smooth(twice.square().mean(0).sqrt(), square, leaves)

    shown = share.float()[:, None]
    inside = value * area * shown
    albedo = (value * area).sum(1, keepdim=True)
    parts = {
        "even": torch.where(leaves.used, area * shown, 0),
        "first": inside,
        "second": inside * albedo,
        "square": inside * value,
    }
    table = directions * sum(_SHARES[name] * _normalized(part) for name, part in parts.items())
    squared = (value.square() * area).sum(1)
    rows = [shown[:, 0] * x for x in (torch.ones_like(squared), albedo[:, 0], squared)]
    near = directions * _SHARES["broad"] * sum(_normalized(x) for x in rows) / len(rows)

    at = cells.stratified(table, stream)
    row, leaf = at // cells.LEAVES, at % cells.LEAVES
    wo = leaves.points(row, leaf, _uniform(stream, len(row), 2, device))
    other = cells.stratified(near, stream)
    broad = _BROAD.sample(condition[other], _uniform(stream, len(other), 3, device)).wo
    row, wo = torch.cat([row, other]), torch.cat([wo, broad])
    # Off the disk f is zero.
    row, wo = row[inside_disk(wo)], wo[inside_disk(wo)]
    order = row.argsort(stable=True)
    row, wo = row[order], wo[order]
    f = luminance(material.eval(condition[row], wo)).double()
    rate = _rates(condition, table / area, near, row, leaves.at(row, wo), wo)

    peak = (value.square() * area).topk(PEAKS, 1).indices
    owner = torch.arange(len(condition), device=device).repeat_interleave(PEAKS)
    there = leaves.points(owner, peak.flatten(), _uniform(stream, len(owner), 2, device))
    seen_f = luminance(material.eval(condition[owner], there)).abs().view(-1, PEAKS)
    return Half(
        pixels=len(pixels),
        condition=condition,
        pixel=pixel,
        set=part,
        share=share,
        albedo=(twice.double() * area).sum(2),
        leaves=leaves,
        value=value,
        table=table,
        near=near,
        row=row,
        wo=wo,
        f=f,
        rate=rate,
        peak_leaf=peak,
        peak_f=torch.maximum(seen_f, value.gather(1, peak)),
        peak_wo=there.view(-1, PEAKS, 2),
    )


def _rows_of(
    prepared: Prepared,
    material: Material,
    pixels: NDArray,
    rng: np.random.Generator,
    stream: torch.Generator,
) -> NDArray:
    """How many rows each pixel gets in a set [P]: one, and more by A^2 and the integral of f^2."""
    first, square = 0.0, 0.0
    for k in range(LOOKS):
        within = rng.random((len(pixels), 2))
        within[:, k % 2] = (within[:, k % 2] + k // 2) / (LOOKS // 2)
        condition = seen.conditions(prepared, pixels, within, _seed(rng))
        by_first, by_square = _look(material, condition, stream)
        first = first + by_first.sum(1).square()
        square = square + by_square.sum(1)
    more = (_normalized(first) + _normalized(square)) / 2 * len(pixels) * EXTRA
    return (1 + more.double().cpu().numpy() + rng.random(len(pixels))).astype(int)


def _points(
    prepared: Prepared, pixels: NDArray, of_set: NDArray, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Conditions of two sets, their pixels and sets, by pixel. A pixel's are stratified in x, y."""
    pixel = np.repeat(np.arange(len(pixels)), of_set)
    strip = np.arange(len(pixel)) - np.repeat(of_set.cumsum() - of_set, of_set)
    found = []
    for _ in range(2):
        order = np.lexsort((rng.random(len(pixel)), pixel))
        other = np.empty_like(strip)
        other[order] = strip
        within = (np.stack([strip, other], 1) + rng.random((len(pixel), 2))) / of_set[pixel, None]
        found.append(seen.conditions(prepared, pixels[pixel], within, _seed(rng)))
    both = torch.from_numpy(np.tile(pixel, 2))
    part = torch.arange(2).repeat_interleave(len(pixel))
    order = both.argsort(stable=True)
    return torch.cat(found)[order.to(found[0].device)], both[order], part[order]


def _look(material: Material, condition: Tensor, stream: torch.Generator) -> tuple[Tensor, Tensor]:
    """Integrals of |f| and f^2 over each coarse cell [N, CELLS], by one direction in each and
    ``NEAR`` of the broad sampler."""
    many = cells.CELLS + NEAR
    found = []
    for rows in torch.split(condition, max(1, _ROWS // many)):
        owner = torch.arange(len(rows), device=rows.device)
        cell = torch.arange(cells.CELLS, device=rows.device).repeat(len(rows))
        even = cells.in_cell(cell, _uniform(stream, len(cell), 2, rows.device))
        near = rows.repeat_interleave(NEAR, 0)
        broad = _BROAD.sample(near, _uniform(stream, len(near), 3, rows.device)).wo
        wo = torch.cat([even.view(len(rows), -1, 2), broad.view(len(rows), -1, 2)], 1).flatten(0, 1)
        inside = inside_disk(wo)
        wo = torch.where(inside[:, None], wo, 0)
        at = rows[owner.repeat_interleave(many)]
        f = luminance(material.eval(at, wo)).abs()
        rate = cells.CELLS / math.pi + NEAR * _BROAD.pdf(at, wo)
        weight = torch.where(inside, f / rate, 0).view(len(rows), many)
        cell = cells.cell_of(wo).view(len(rows), many)
        zero = torch.zeros(len(rows), cells.CELLS, device=rows.device)
        once = zero.scatter_add(1, cell, weight)
        found.append((once, zero.scatter_add(1, cell, weight * f.view(len(rows), many))))
    once, twice = (torch.cat(parts) for parts in zip(*found, strict=True))
    return once, twice


def _in_leaves(
    material: Material, condition: Tensor, leaves: cells.Leaves, stream: torch.Generator
) -> Tensor:
    """f at one direction in each leaf [N, LEAVES]; zero where there is no leaf."""
    parts = []
    for rows in torch.split(
        torch.arange(len(condition), device=condition.device), max(1, _ROWS // cells.USED)
    ):
        used = leaves.used[rows]
        row, leaf = used.nonzero(as_tuple=True)
        row = rows[row]
        wo = leaves.points(row, leaf, _uniform(stream, len(row), 2, condition.device))
        f = torch.zeros(used.shape, device=condition.device)
        f[used] = luminance(material.eval(condition[row], wo))
        parts.append(f)
    return torch.cat(parts)


def _smooth(value: Tensor, square: Tensor, leaves: cells.Leaves) -> Tensor:
    """About |f| in each leaf [N, LEAVES]: what was met there and, in part, around it.

    ``square`` [N, CELLS] are integrals of f^2 over cells, by other directions.
    """
    whole, fine = value[:, : cells.CELLS], value[:, cells.CELLS :]
    before = (square / (math.pi / cells.CELLS)).sqrt()
    whole = torch.where(leaves.rank < 0, torch.maximum(whole, before / 2), 0)
    fine = fine.reshape(-1, cells.PARTS)
    around = before.gather(1, leaves.divided).reshape(-1, 1)
    fine = 0.5 * fine + 0.3 * cells.spread(fine, cells.FINE) + 0.1 * around
    return torch.cat([whole, fine.reshape(len(value), -1)], 1)


def _rates(
    condition: Tensor, table: Tensor, near: Tensor, row: Tensor, leaf: Tensor, wo: Tensor
) -> Tensor:
    broad = near[row].double() * _BROAD.pdf(condition[row], wo).double()
    return table[row, leaf].double() + broad


def _normalized(x: Tensor) -> Tensor:
    """With the sum one; zero where there is nothing."""
    total = x.sum(dtype=torch.float64)
    return (x / total).float() if total > 0 else x.float()


def _uniform(stream: torch.Generator, n: int, d: int, device: torch.device) -> Tensor:
    return torch.rand(n, d, generator=stream).to(device)


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))
