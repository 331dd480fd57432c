r"""The plane onto the open disk, coordinate by coordinate, and the logistic points it starts from.

.. math:: x = \tanh\tfrac a2, \quad y = \sqrt{1 - x^2}\,\tanh\tfrac b2, \qquad
          a = \log\frac{1 + x}{1 - x}, \quad
          b = 2\,\mathrm{arsinh}\frac{y}{\sqrt\delta} = \pm \log\frac{(h + |y|)^2}{\delta}

with the half chord :math:`h = \sqrt{1 - x^2}` and :math:`\delta = 1 - x^2 - y^2`. x is any number
of (-1, 1), y then any of the chord's: a bijection of the plane onto the open disk, with

.. math:: \Big|\frac{\partial(x, y)}{\partial(a, b)}\Big| = \frac{h\,\delta}{4}

:math:`\delta` is found without a difference of squares near one, so the density at the rim is as
exact as the rounded direction lets it be. The base is logistic: :math:`z = \log\frac{u}{1 - u}` of
a uniform u has the density u (1 - u). A logistic tail stretched by s falls like a power of the
distance from the end, the (1 / s - 1)-th, and not faster, as a Gaussian's would.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Float

RIM = 2.0**-16
"""So near the rim the chord is shorter than rounding lets it be known, for any map."""
_HALF_STEP = 2.0**-25
"""Half of what uniforms of single precision are apart: 0 stands for what lies up to the next."""


class PlanePoint(NamedTuple):
    """Coordinates ``a`` and ``b`` [...] of directions, and log |d(a, b) / d(x, y)| [...]."""

    a: Tensor
    b: Tensor
    log_density: Tensor


def plane_of_disk(wo: Tensor) -> PlanePoint:
    """Of ``wo`` [..., 2]; off the disk the coordinates are zero and the log density -inf."""
    inside = wo.square().sum(-1) < 1
    x, y = torch.where(inside[..., None], wo, 0).unbind(-1)
    squared = (1 - x) * (1 + x)
    rest = squared - y * y
    # The sum of squares may round to less than one where their difference rounds to nothing.
    inside = inside & (rest > 0)
    rest = torch.where(rest > 0, rest, 1)
    a = torch.log1p(x) - torch.log1p(-x)
    b = 2 * torch.asinh(y * rest.rsqrt())
    log_density = torch.log(torch.full_like(x, 4)) - 0.5 * squared.log() - rest.log()
    return PlanePoint(a, b, torch.where(inside, log_density, -torch.inf))


def disk_of_plane(a: Tensor, b: Tensor) -> Tensor:
    """Directions [..., 2] of coordinates [...]."""
    # The chord is 1 / cosh(a / 2).
    return torch.stack([torch.tanh(a / 2), torch.tanh(b / 2) / torch.cosh(a / 2)], -1)


def log_density_of_plane(a: Tensor, b: Tensor) -> Tensor:
    r"""Log of :math:`|d(a, b) / d(x, y)| = 4 \cosh^3\frac a2 \cosh^2\frac b2` [...]."""
    return math.log(4) + 3 * _log_cosh(a / 2) + 2 * _log_cosh(b / 2)


def off_the_rim(wo: Tensor) -> Tensor:
    """``wo`` [..., 2], those within :data:`RIM` of the rim moved in by as much."""
    radius = wo.norm(dim=-1, keepdim=True)
    # The clamp changes nothing where its branch is taken; elsewhere it keeps the quotient finite.
    return torch.where(radius < 1 - RIM, wo, wo * (1 - RIM) / radius.clamp(min=1 - RIM))


def _log_cosh(t: Tensor) -> Tensor:
    return torch.nn.functional.softplus(-2 * t.abs()) + t.abs() - math.log(2)


def log_logistic(z: Tensor) -> Tensor:
    """Log density of logistic points: log(u (1 - u))."""
    return -torch.nn.functional.softplus(z) - torch.nn.functional.softplus(-z)


# --- over columns ----------------------------------------------------------------------


def logistic_columns(u: Float) -> Float:
    """A logistic point from a uniform in [0, 1); finite, for 0 stands for half of the next."""
    return dr.log((u + _HALF_STEP) / (1 - u))


def logistic_pdf_columns(z: Float) -> tuple[Float, Float]:
    """``(u (1 - u), 2 u - 1)`` of a logistic point; no exponential overflows."""
    e = dr.exp(-dr.abs(z))
    below = dr.rcp(1 + e)
    return e * below * below, dr.copysign((1 - e) * below, z)


def a_columns(x: Float) -> Float:
    """The first coordinate of x; zero on the rim and beyond, where there is none."""
    outside = dr.abs(x) >= 1
    return dr.log(dr.select(outside, 1, (1 + x) / (1 - x)))


def chord_columns(x: Float) -> Float:
    """Half the disk's height at ``x``; one where there is no disk."""
    squared = dr.fma(-x, x, 1)
    return dr.sqrt(dr.select(squared > 0, squared, 1))


def b_columns(x: Float, y: Float) -> tuple[Float, Float]:
    """The second coordinate, and |d(a, b) / d(x, y)|; zero, the latter, on the rim and beyond."""
    # Each rounded once, and in every kernel alike.
    squared = dr.fma(-x, x, 1)
    rest = dr.fma(-y, y, squared)
    # A nan compares with nothing, and has to come out as one.
    outside = (rest <= 0) | (squared <= 0)
    chord = dr.sqrt(dr.select(outside, 1, squared))
    rest = dr.select(outside, 1, rest)
    total = chord + dr.abs(y)
    b = dr.copysign(dr.log(total * total / rest), y)
    return dr.select(outside, 0, b), dr.select(outside, 0, 4 / (chord * rest))


def x_columns(a: Float) -> Float:
    """x of its coordinate; -1 or 1, on the rim, where no number is nearer."""
    return dr.tanh(0.5 * a)


def y_columns(b: Float, chord: Float) -> Float:
    """y of its coordinate; -1 or 1, off the disk, where the rim is nearer than any number."""
    t = dr.tanh(0.5 * b)
    return dr.select(dr.abs(t) == 1, t, t * chord)
