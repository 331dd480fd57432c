r"""The projected disk, on which all densities of the harness live.

A direction :math:`\omega = (x, y, z)` of the upper hemisphere is represented by its
projection :math:`(x, y)`; the solid-angle element projects to the area element
:math:`dx\,dy = \cos\theta\,d\omega`, hence

.. math:: p_\sigma(\omega) = p_\perp(x, y)\,\cos\theta .

All functions take and return tensors of any leading shape and never write to their inputs.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

REC709 = (0.212671, 0.715160, 0.072169)


def luminance(rgb: Tensor) -> Tensor:
    """Rec. 709 luminance, the last axis ``[..., 3] -> [...]`` (Mitsuba's weights)."""
    return rgb @ torch.tensor(REC709, dtype=rgb.dtype, device=rgb.device)


def inside_disk(wo: Tensor) -> Tensor:
    """Whether ``wo`` [..., 2] is a direction of the open upper hemisphere: bool [...]."""
    return wo.square().sum(-1) < 1


def cos_theta(wo: Tensor) -> Tensor:
    """Cosine of the polar angle, [..., 2] -> [...]; zero outside the disk."""
    # Outside the disk there is no direction; zero is what every caller multiplies by.
    return (1 - wo.square().sum(-1)).clamp(min=0).sqrt()


def to_direction(wo: Tensor) -> Tensor:
    """Unit vectors [..., 3] of the upper hemisphere above the points ``wo`` [..., 2]."""
    return torch.cat([wo, cos_theta(wo)[..., None]], -1)


def disk_to_solid_angle(pdf_disk: Tensor, wo: Tensor) -> Tensor:
    """Density per steradian from density per disk area: times cos(theta)."""
    return pdf_disk * cos_theta(wo)


def solid_angle_to_disk(pdf_solid: Tensor, wo: Tensor) -> Tensor:
    """Density per disk area from density per steradian: over cos(theta).

    At the rim (cos = 0) the ratio has no value; the result there is inf or nan.
    """
    return pdf_solid / cos_theta(wo)


def square_to_disk(u: Tensor) -> Tensor:
    """Equal-area concentric map [0,1]^2 -> unit disk, [..., 2] -> [..., 2].

    Its Jacobian is the constant pi, so a uniform square gives the uniform disk of
    density 1/pi. Radii are shrunk by four units in the last place, so that rounding puts no
    point on the rim, which is no direction of the open hemisphere. After Shirley and Chiu
    (1997), A Low Distortion Map Between Disk and Square.
    """
    a, b = (2 * u - 1).unbind(-1)
    wide = a.abs() > b.abs()
    r = torch.where(wide, a, b)
    # r = 0 only where both are: the angle is then arbitrary, so divide by one.
    ratio = torch.where(wide, b, a) / torch.where(r == 0, torch.ones_like(r), r)
    phi = torch.where(wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    r = r * (1 - 4 * torch.finfo(r.dtype).eps)
    return torch.stack([r * phi.cos(), r * phi.sin()], -1)


def disk_to_square(wo: Tensor) -> Tensor:
    """Inverse of :func:`square_to_disk`; points outside the disk land outside the square."""
    x, y = wo.unbind(-1)
    radius = torch.hypot(x, y)
    phi = torch.atan2(y, x)
    phi = torch.where(phi < -math.pi / 4, phi + 2 * math.pi, phi)
    # Kept in the dtype of wo: an integer tensor times a number would be single precision.
    quadrant = torch.floor((phi + math.pi / 4) / (math.pi / 2)).clamp(0, 3)
    local = (phi - quadrant * (math.pi / 2)) * radius * (4 / math.pi)
    a = torch.where(quadrant == 0, radius, torch.where(quadrant == 2, -radius, -local))
    b = torch.where(quadrant == 1, radius, torch.where(quadrant == 3, -radius, local))
    a = torch.where(quadrant == 3, local, a)
    b = torch.where(quadrant == 2, -local, b)
    return (torch.stack([a, b], -1) + 1) / 2
