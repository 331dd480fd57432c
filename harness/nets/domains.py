r"""The plane that a flow acts on: the projected disk itself, a square, or the whole plane.

``disk``: the direction's own coordinates. ``square``: :math:`(x / \sqrt{1 - y^2},\, y)`, which puts
the rim on edges; off the disk, |y| >= 1, x is left as it is. ``plane``: the open disk as the plane,

.. math:: z = \frac{\omega}{r} \sqrt{-2 \log(1 - r^2)}, \qquad
          \left|\frac{\partial z}{\partial \omega}\right| = \frac{2}{1 - r^2}

which takes the uniform disk to the standard normal (Box and Muller, 1958): no sample is off the
disk, the rim need not be learnt, and a flow that does nothing draws the Lambertian lobe. A
direction off the disk has no point of the plane.
"""

from __future__ import annotations

import math

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float

DOMAINS = ("disk", "square", "plane")
_SMALL = 1e-4
"""Squared radii below which three terms of a series are exact to twelve digits."""
_NEAR = 0.05
"""Below this, in single precision, a logarithm or an exponential near one has lost more digits
than a longer series leaves out."""


def from_disk(domain: str, wo: Tensor) -> tuple[Tensor, Tensor]:
    """Place [..., 2] of directions ``wo`` [..., 2], and log |d place / d wo| [...].

    In ``plane``, minus infinity where there is no such place, which is then the origin.
    """
    if domain == "disk":
        return wo, torch.zeros_like(wo[..., 0])
    if domain == "square":
        log_chord = _log_chord(wo[..., 1])
        return torch.stack([wo[..., 0] * torch.exp(-log_chord), wo[..., 1]], -1), -log_chord
    squared = wo.square().sum(-1)
    # So compared, a nan stays one.
    off = squared >= 1
    squared = torch.where(off, 0, squared)
    series = 2 + squared * (1 + squared * (2 / 3))
    safe = torch.where(squared < _SMALL, 0.5, squared)
    ratio = torch.where(squared < _SMALL, series, -2 * torch.log1p(-safe) / safe)
    place = torch.where(off[..., None], 0, wo) * ratio.sqrt()[..., None]
    log_slope = math.log(2) - torch.log1p(-squared)
    return place, torch.where(off, -math.inf, log_slope)


def to_disk(domain: str, place: Tensor) -> Tensor:
    """The direction [..., 2] of a place: the inverse of :func:`from_disk`."""
    if domain == "disk":
        return place
    if domain == "square":
        x, y = place.unbind(-1)
        return torch.stack([x * torch.exp(_log_chord(y)), y], -1)
    squared = place.square().sum(-1)
    safe = torch.where(squared < _SMALL, 0.5, squared)
    series = 0.5 - squared * (1 / 8 - squared * (1 / 48))
    ratio = torch.where(squared < _SMALL, series, -torch.expm1(-safe / 2) / safe)
    return place * ratio.sqrt()[..., None]


def from_disk_columns(domain: str, wo: Columns) -> tuple[Columns, Float]:
    """:func:`from_disk` over columns, with the slope itself: 0 off the disk in ``plane``."""
    x, y = wo
    if domain == "disk":
        return [x, y], type(x)(1)
    if domain == "square":
        chord = _chord(y)
        return [x / chord, y], 1 / chord
    squared = dr.fma(x, x, y * y)
    off = squared >= 1
    squared = dr.select(off, 0, squared)
    rest = 1 - squared
    series = _polynomial(squared, [2, 1, 2 / 3, 1 / 2, 2 / 5, 1 / 3])
    ratio = dr.select(squared < _NEAR, series, -2 * dr.log(rest) / squared)
    scale = dr.sqrt(ratio)
    return [dr.select(off, 0, v * scale) for v in wo], dr.select(off, 0, 2 / rest)


def to_disk_columns(domain: str, place: Columns) -> Columns:
    """:func:`to_disk` over columns."""
    x, y = place
    if domain == "disk":
        return [x, y]
    if domain == "square":
        return [x * _chord(y), y]
    squared = dr.fma(x, x, y * y)
    series = _polynomial(squared, [1 / 2, -1 / 8, 1 / 48, -1 / 384])
    ratio = dr.select(squared < _NEAR, series, (1 - dr.exp(-0.5 * squared)) / squared)
    scale = dr.sqrt(ratio)
    return [v * scale for v in place]


def _log_chord(y: Tensor) -> Tensor:
    squared = (1 - y) * (1 + y)
    return 0.5 * torch.where(squared > 0, squared, 1).log()


def _chord(y: Float) -> Float:
    """Half the disk's width at ``y``; one where there is none."""
    squared = (1 - y) * (1 + y)
    return dr.sqrt(dr.select(squared > 0, squared, 1))


def _polynomial(x: Float, terms: list[float]) -> Float:
    """Coefficients from the constant on."""
    value = type(x)(terms[-1])
    for term in terms[-2::-1]:
        value = dr.fma(value, x, term)
    return value
