r"""Three numbers as a direction of the upper hemisphere, and the determinant of a map to it.

.. math:: \omega = \frac{(a, b, s)}{\lVert (a, b, s) \rVert}, \quad s = \log(1 + e^c) > 0

For any a, b and c the direction is above the horizon, so no sample is invalid. With derivatives
of (a, b, c) along two parameters :math:`z_1, z_2`, the projection (x, y) of :math:`\omega` has

.. math:: \partial_k (x, y) = \frac{\partial_k (a, b) - (x, y)\,(x\,\partial_k a + y\,\partial_k b
          + w\,\partial_k s)}{\lVert (a, b, s) \rVert}, \quad
          \det J = \partial_1 x\,\partial_2 y - \partial_2 x\,\partial_1 y

with w the direction's cosine: disk area per area of the plane of z, negative where it is folded.
"""

from __future__ import annotations

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float


def direction(raw: Tensor) -> Tensor:
    """Points [..., 2] of the disk from ``raw`` [..., 3]."""
    a, b, c = raw.unbind(-1)
    s = torch.nn.functional.softplus(c)
    length = (a * a + b * b + s * s).sqrt()
    return torch.stack([a, b], -1) / length[..., None]


def direction_and_determinant(raw: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Points [..., 2] and det J [...] from ``raw`` [..., 3] and ``slopes`` [2, ..., 3]."""
    a, b, c = raw.unbind(-1)
    s, gate = torch.nn.functional.softplus(c), torch.sigmoid(c)
    scale = (a * a + b * b + s * s).rsqrt()
    found = (a * scale, b * scale, s * scale)
    by = [_slope(found, scale, t[..., 0], t[..., 1], gate * t[..., 2]) for t in slopes]
    return torch.stack(found[:2], -1), _determinant(by)


def direction_and_determinant_columns(
    raw: Columns, slopes: list[Columns]
) -> tuple[Float, Float, Float]:
    """``(x, y, det J)`` over columns."""
    a, b, c = raw
    # Like this neither end overflows.
    s = dr.maximum(c, 0 * c) + dr.log(1 + dr.exp(-dr.abs(c)))
    gate = 1 / (1 + dr.exp(-c))
    scale = dr.rcp(dr.sqrt(dr.fma(a, a, dr.fma(b, b, s * s))))
    found = (a * scale, b * scale, s * scale)
    by = [_slope(found, scale, t[0], t[1], gate * t[2]) for t in slopes]
    return found[0], found[1], _determinant(by)


def _slope(found, scale, da, db, ds):
    x, y, w = found
    along = x * da + y * db + w * ds
    return (da - x * along) * scale, (db - y * along) * scale


def _determinant(by):
    (x1, y1), (x2, y2) = by
    return x1 * y2 - x2 * y1
