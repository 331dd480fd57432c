r"""Slices of a family: f of one condition on a Cartesian grid over the disk.

A cell's mean is estimated from stratified points in every cell. Where the density of the
model's own sampler says that a lobe is narrower than a few strata, points which that sampler
draws join them, by the balance heuristic: a point contributes :math:`f / (n_1 p_1 + n_2 p_2)`
to its cell's integral, with :math:`n p` the expected number of points of a set per area.
Elsewhere strata alone are better, for the number of drawn points in a cell is random.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, columns_of, tensor_of
from harness.materials.families.hashing import generator_at

STRATA = 4
"""Strata per side of a cell, each with one point."""
DRAWN = 3
"""Points per cell, on average over the grid, from the model's own sampler."""
NARROW = 0.003
"""Density times the area of a stratum from which a lobe is narrow: its width is then about
ten strata, and thousands of drawn points fall into a cell of 128 x 128."""
LANES = 1 << 22
"""Points that are evaluated at once: 16 MB a column."""


class Sampled(Protocol):
    """What is asked of a family, over columns: its evaluation and its own sampler."""

    def evaluator(self, condition: Columns, seed: int) -> Callable[..., Columns]: ...

    def native_sample_columns(self, condition: Columns, u: Columns) -> tuple[Any, Any, Any]: ...

    def native_pdf_columns(self, condition: Columns, wo: Columns) -> Any: ...


def slices(family: Sampled, condition: Tensor, resolution: int, seed: int) -> Tensor:
    r"""Mean of f over cells, rgb [N, R, R, 3], for ``condition`` [N, C].

    The R x R cells divide [-1, 1]^2; row = y, column = x, from -1 up. f is zero outside
    the disk, so a cell that the rim cuts has the mean of a part, and

    .. math:: \sum_{cells} \bar f\,(2/R)^2 \approx \int f\,dA

    is the directional albedo. ``STRATA``^2 + ``DRAWN`` evaluations a cell. ``seed`` chooses the
    points, and the random walks if f is a mean over them; a row's slice does not depend on
    the other rows of the call.
    """
    n, cells = len(condition), resolution**2
    total = torch.zeros(n * cells, 3, dtype=torch.float64, device=condition.device)
    if total.numel() == 0:
        return total.view(n, resolution, resolution, 3).to(condition.dtype)
    with torch.no_grad():
        c = columns_of(condition)
        evaluate = family.evaluator(c, seed)
        for points, count in ((_even, STRATA**2), (_drawn, DRAWN)):
            for start in range(0, n * cells * count, LANES):
                stop = min(start + LANES, n * cells * count)
                # Opaque, so that the next chunk finds the kernel compiled.
                unsigned = dr.uint32_array_t(type(c[0]))
                lane = dr.opaque(unsigned, start) + dr.arange(unsigned, stop - start)
                row, place = lane // (cells * count), lane % (cells * count)
                wide = [dr.gather(type(column), column, row) for column in c]
                wo = points(family, wide, place, resolution, seed)
                drawn = family.native_pdf_columns(wide, wo)
                even = 0.25 * STRATA**2 * cells
                narrow = drawn > NARROW * even
                weight = 1 / (even + dr.select(narrow, DRAWN * cells * drawn, 0))
                f = evaluate(row, wide, wo)
                if points is _drawn:
                    weight = dr.select(narrow, weight, 0)
                cell = row * cells + _cell(wo, resolution)
                _add(total, cell, [v * weight for v in f], stop - start)
    return (total * (0.25 * cells)).to(condition.dtype).view(n, resolution, resolution, 3)


def _even(family: Sampled, c: Columns, place: Any, resolution: int, seed: int) -> Columns:
    """One jittered point [x, y] in each stratum of each cell."""
    array, across = type(c[0]), resolution * STRATA
    rng = generator_at([array(place)], seed)
    return [
        dr.fma(array(v) + rng.next_float32(), 2 / across, -1)
        for v in (place % across, place // across)
    ]


def _drawn(family: Sampled, c: Columns, place: Any, resolution: int, seed: int) -> Columns:
    """Points of the model's sampler from stratified uniforms; invalid ones stay off the disk."""
    array, cells = type(c[0]), resolution**2
    # Another stream than that of the strata.
    rng = generator_at([array(place)], seed ^ (1 << 63))
    stratum, layer = place % cells, place // cells
    u = [
        (array(layer) + rng.next_float32()) / DRAWN,
        (array(stratum % resolution) + rng.next_float32()) / resolution,
        (array(stratum // resolution) + rng.next_float32()) / resolution,
    ]
    x, y, _ = family.native_sample_columns(c, u)
    return [x, y]


def _cell(wo: Columns, resolution: int) -> Any:
    """Number of the cell of a point; what is off the square has f = 0 and may go anywhere."""
    unsigned = dr.uint32_array_t(type(wo[0]))
    x, y = (unsigned(dr.clip((v + 1) * (resolution / 2), 0, resolution - 1)) for v in wo)
    return y * resolution + x


def _add(total: Tensor, cell: Any, values: Columns, rows: int) -> None:
    """Add ``values`` to the rows ``cell`` of ``total``; on a CPU always in the same order."""
    index = tensor_of(cell, rows=rows).long()
    for channel, column in enumerate(values):
        value = tensor_of(column, rows=rows).double()
        total[:, channel] += torch.bincount(index, value, len(total))
