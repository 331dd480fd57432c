r"""Feature textures: wrapped, bilinear, half-texel lookup; pyramids; Gaussian blur.

A texture is a table of rows, a row a texel: [R * R, C], row ``y * R + x`` of the texel with its
centre at ``((x + 0.5) / R, (y + 0.5) / R)``. A pyramid is one table with its levels one after
another, the finest first: R, R / 2, ..., 1 texels a side.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

LEAST_BLUR = 0.15
"""In texels; a neighbour's weight is then 2e-10, and nothing is left of a blur."""


def sides(resolution: int, levels: int) -> list[int]:
    """Texels a side of every level."""
    return [resolution >> level for level in range(levels)]


def rows(resolution: int, levels: int) -> int:
    """Rows of the table."""
    return sum(side * side for side in sides(resolution, levels))


def lookup(table: Tensor, side: int, uv: Tensor) -> Tensor:
    """Bilinear lookup in one texture ``table`` [side^2, C] at ``uv`` [N, 2], wrapped: [N, C].

    Differentiable in both, by torch's ``grid_sample``, whose gradient is three times as fast
    as that of a weighted gather.
    """
    image = table.view(side, side, -1).permute(2, 0, 1)[None]
    image = nn.functional.pad(image, (1, 1, 1, 1), mode="circular")
    # Texel centres of the padded image, mapped to its [-1, 1].
    at = (uv - uv.detach().floor()) * side
    grid = (2 * at + 2) / (side + 2) - 1
    found = nn.functional.grid_sample(image, grid[None, None], align_corners=False)
    return found[0, :, 0].T


def lookup_pyramid(
    table: Tensor, resolution: int, levels: int, uv: Tensor, level: Tensor
) -> Tensor:
    r"""Trilinear lookup, eq. 3 of NeuMIP: [N, C] at ``uv`` [N, 2] and ``level`` [N].

    .. math:: P(u, \sigma) = (1 - t)\,T_{\lfloor l \rfloor}(u) + t\,T_{\lfloor l \rfloor + 1}(u),
              \qquad t = l - \lfloor l \rfloor

    with levels counted from the finest, 0, and beyond either end that end's texture. (The paper's
    weights :math:`\lceil l \rceil - l` and :math:`l - \lfloor l \rfloor` are these, but both
    vanish where l is whole.)
    """
    level = level.clamp(0, levels - 1)
    # So the upper of the two exists; at the coarsest level its weight is then 1.
    lower = level.floor().clamp(max=max(levels - 2, 0))
    share = (level - lower)[:, None]
    size = torch.tensor(sides(resolution, levels), device=uv.device)
    first = torch.cat([size.new_zeros(1), (size * size).cumsum(0)[:-1]])
    lower = lower.long()
    found_index, found_weight = [], []
    for which, part in ((lower, 1 - share), ((lower + 1).clamp(max=levels - 1), share)):
        index, weight = _taps(size[which], uv)
        found_index.append(index + first[which][:, None])
        found_weight.append(weight * part)
    return nn.functional.embedding_bag(
        torch.cat(found_index, 1),
        table,
        per_sample_weights=torch.cat(found_weight, 1),
        mode="sum",
    )


def level_of(kernel: Tensor, resolution: int) -> Tensor:
    r"""Level of detail of a footprint's standard deviation in uv: :math:`l = \log_2(2 \sigma R)`.

    A deviation of half a texel is that texel's own level: 0 at the finest. Below 0 for less;
    -inf for a point, which lookups take as the finest.
    """
    return torch.log2(2 * resolution * kernel)


def kernel_of(level: float, resolution: int) -> float:
    """Inverse of :func:`level_of` for one number."""
    return 2.0**level / (2 * resolution)


def decayed(sigma: float, halvings: float, share: float) -> float:
    """Deviation of a blur after ``share`` of its time, ``sigma`` at first; 0 below the least.

    Deviations are in texels; the whole time halves them ``halvings`` times.
    """
    now = sigma * 2 ** (-halvings * share)
    return now if now > LEAST_BLUR else 0.0


def blur(table: Tensor, side: int, sigma: float) -> Tensor:
    """One texture [side^2, C] blurred by a wrapped Gaussian of ``sigma`` texels.

    Differentiable. Weights are the Gaussian's at whole texels, normalised; 0 is the identity.
    """
    if sigma == 0 or side == 1:
        return table
    ring = _ring(side, sigma).to(table)
    image = table.view(side, side, -1)
    image = torch.einsum("yj,jxc->yxc", ring, image)
    return torch.einsum("xj,yjc->yxc", ring, image).reshape(side * side, -1)


def blur_pyramid(table: Tensor, resolution: int, levels: int, sigma: float) -> Tensor:
    """Every level blurred by ``sigma`` of its own texels."""
    if sigma == 0:
        return table
    size = sides(resolution, levels)
    parts = table.split([side * side for side in size])
    return torch.cat([blur(part, side, sigma) for part, side in zip(parts, size, strict=True)])


def _taps(side: int | Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
    """Rows [N, 4] of the texels around ``uv`` and their weights; ``side`` a number or [N]."""
    size = side[:, None] if isinstance(side, Tensor) else side
    at = uv * size - 0.5
    corner = at.detach().floor()
    tx, ty = (at - corner).unbind(1)
    corner = corner.long()
    x0, y0 = torch.remainder(corner, size).unbind(1)
    x1, y1 = torch.remainder(corner + 1, size).unbind(1)
    index = torch.stack([y0 * side + x0, y0 * side + x1, y1 * side + x0, y1 * side + x1], 1)
    sx, sy = 1 - tx, 1 - ty
    return index, torch.stack([sy * sx, sy * tx, ty * sx, ty * tx], 1)


def _ring(side: int, sigma: float) -> Tensor:
    """Circulant matrix [side, side] of the wrapped Gaussian; rows sum to one."""
    reach = max(1, math.ceil(6 * sigma))
    step = torch.arange(-reach, reach + 1, dtype=torch.float64)
    weight = torch.exp(-0.5 * (step / sigma) ** 2)
    row = torch.zeros(side, dtype=torch.float64)
    row.index_add_(0, torch.remainder(step.long(), side), weight / weight.sum())
    index = torch.arange(side)
    return row[torch.remainder(index[:, None] - index, side)]
