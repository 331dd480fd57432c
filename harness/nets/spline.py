r"""Monotonic rational-quadratic splines: Durkan et al. (2019), Neural Spline Flows, section 3.

A spline maps the line to itself: increasing, once differentiable, the identity outside
[-1, 1]. Inside, K bins with knots :math:`(x_k, y_k)` and derivatives :math:`d_k`; with the
bin's slope :math:`s`, :math:`\xi = (x - x_k) / (x_{k+1} - x_k)` and
:math:`\bar\xi = 1 - \xi`, their equations 4 and 5 are

.. math:: D = s\,(\xi^2 + \bar\xi^2) + (d_k + d_{k+1})\,\xi\bar\xi, \qquad
   \theta = \frac{s\,\xi^2 + d_k\,\xi\bar\xi}{D}, \qquad
   y' = \frac{s^2\,(d_{k+1}\xi^2 + 2 s\,\xi\bar\xi + d_k\bar\xi^2)}{D^2}

where :math:`y = y_k + \theta\,(y_{k+1} - y_k)`. Written this way no term is negative, so
nothing cancels; nor does anything in the inverse (:func:`_solve`), where their equations 6
to 8 lose all digits at the end of a steep bin, or take the root of a negative discriminant.

A network gives 3K - 1 numbers: logits of the K widths, logits of the K heights, and the
inner derivatives. Each width and height is at least 0.001 of the interval and each
derivative at least 0.001, by parameterisation; all zeros is the identity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float

Bool = Any

MINIMUM = 1e-3
"""Least share of the interval in a bin's width and height, and least derivative."""

_STEEPEST = 1e3
# softplus of this and the minimum make one: a derivative's zero output is slope one.
_UNIT = math.log(math.expm1(1 - MINIMUM))


class Bin(NamedTuple):
    """A bin's corners and end derivatives, as tensors or as columns.

    Corners are relative to ``anchor``, the end of the interval (-1 or 1) on the bin's side:
    near the ends, where densities are steepest, positions keep their relative precision.
    """

    anchor: Tensor | Float
    x0: Tensor | Float
    x1: Tensor | Float
    y0: Tensor | Float
    y1: Tensor | Float
    d0: Tensor | Float
    d1: Tensor | Float


def outputs(bins: int) -> int:
    """How many numbers describe a spline of ``bins`` bins."""
    return 3 * bins - 1


def _tempered(raw: Tensor | Float) -> Tensor | Float:
    # The identity for small numbers; bounded, so that squares of derivatives stay finite.
    return raw / (1 + abs(raw) * (1 / _STEEPEST))


def derivative(raw: Tensor) -> Tensor:
    """Knot derivatives, between 0.001 and 1001, from a network's outputs of any size."""
    return MINIMUM + torch.nn.functional.softplus(_tempered(raw) + _UNIT)


def derivative_columns(raw: Float) -> Float:
    """:func:`derivative` over a column."""
    v = _tempered(raw) + _UNIT
    return MINIMUM + dr.maximum(v, 0) + dr.log(1 + dr.exp(-dr.abs(v)))


def _summation(bins: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """``(matrix, constant)`` that make knots [K + 1] of bin shares [K].

    Knots up to K // 2 count from -1, those beyond from 1 (and are negative).
    """
    knot, size = torch.arange(bins + 1), torch.arange(bins)[:, None]
    left = knot <= bins // 2
    matrix = torch.where(left, (size < knot).double(), -(size >= knot).double())
    constant = 2 * MINIMUM * torch.where(left, knot, knot - bins).double()
    return ((2 - 2 * MINIMUM * bins) * matrix).to(like), constant.to(like)


def _find(raw: Tensor, value: Tensor, axis: int) -> Bin:
    """The bin of ``value`` [...] by its knots on one axis: 0 for x, 1 for y.

    ``raw`` may have axes of length one where all values share a spline.
    """
    bins = (raw.shape[-1] + 1) // 3
    half = bins // 2
    matrix, constant = _summation(bins, raw)
    shares = torch.softmax(raw[..., : 2 * bins].unflatten(-1, (2, bins)), -1)
    knots = shares @ matrix + constant
    inner = knots[..., axis, :].detach()
    at = value.detach()[..., None]
    k = (inner[..., 1 : half + 1] <= at + 1).sum(-1, keepdim=True)
    k = k + (inner[..., half + 1 : bins] <= at - 1).sum(-1, keepdim=True)
    pair = torch.cat([k, k + 1], -1)

    def wide(numbers: Tensor) -> Tensor:
        return numbers.expand(*value.shape, -1)

    (x0, x1), (y0, y1) = (
        (a, b + torch.where(k[..., 0] == half, 2, 0))
        for a, b in (wide(knots[..., i, :]).gather(-1, pair).unbind(-1) for i in (0, 1))
    )
    slopes = wide(torch.nn.functional.pad(raw[..., 2 * bins :], (1, 1))).gather(-1, pair)
    anchor = torch.where(k[..., 0] > half, 1, -1)
    return Bin(anchor, x0, x1, y0, y1, *derivative(slopes).unbind(-1))


def _evaluate(b: Bin, x: Tensor | Float, clip: Callable) -> tuple[Tensor | Float, ...]:
    """``(y, s, numerator, D)`` at ``x`` in its bin: the module's equations."""
    width, height = b.x1 - b.x0, b.y1 - b.y0
    s = height / width
    # A rounding may put x an ulp outside its bin; both maps end there at the knot's value.
    x = clip(x - b.anchor, b.x0, b.x1)
    xi, rest = (x - b.x0) / width, (b.x1 - x) / width
    mixed, square, opposite = xi * rest, xi * xi, rest * rest
    d = s * (square + opposite) + (b.d0 + b.d1) * mixed
    y = b.anchor + (b.y0 + height * ((s * square + b.d0 * mixed) / d))
    return y, s, b.d1 * square + 2 * s * mixed + b.d0 * opposite, d


def _solve(
    b: Bin, y: Tensor | Float, clip: Callable, sqrt: Callable, where: Callable
) -> Tensor | Float:
    r"""The ``x`` of ``y`` in its bin.

    With :math:`e = d_k (1 - \theta) - d_{k+1}\theta` the quadratic's discriminant is
    :math:`e^2 + 4 s^2\,\theta(1 - \theta)`, a sum of squares. Seen from the bin's end that
    ``e`` points away from, the root is a ratio of sums of non-negative numbers.
    """
    width, height = b.x1 - b.x0, b.y1 - b.y0
    s = height / width
    y = clip(y - b.anchor, b.y0, b.y1)
    theta, rest = (y - b.y0) / height, (b.y1 - y) / height
    e = b.d0 * rest - b.d1 * theta
    t = abs(e) + sqrt(e * e + 4 * s * s * theta * rest)
    rising = e >= 0
    near = 2 * s * where(rising, theta, rest)
    step = width * (near / (near + t))
    return b.anchor + where(rising, b.x0 + step, b.x1 - step)


def warp(raw: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """``(y, log dy/dx)`` [...] at ``x`` [...] for outputs ``raw`` [..., 3K - 1]."""
    inside = x.abs() < 1
    # Outside, the bins' value is not used: any point inside keeps its gradient finite.
    safe = torch.where(inside, x, 0)
    y, s, numerator, d = _evaluate(_find(raw, safe, 0), safe, torch.clamp)
    log_slope = 2 * (s / d).log() + numerator.log()
    return torch.where(inside, y, x), torch.where(inside, log_slope, 0)


def unwarp(raw: Tensor, y: Tensor) -> Tensor:
    """Inverse of :func:`warp`: ``x`` [...]."""
    inside = y.abs() < 1
    safe = torch.where(inside, y, 0)
    return torch.where(
        inside, _solve(_find(raw, safe, 1), safe, torch.clamp, torch.sqrt, torch.where), y
    )


def _find_columns(raw: Columns, value: Float, axis: int | Bool) -> Bin:
    """:func:`_find` by walking over the bins, keeping the last that begins at or before.

    ``axis`` may be a mask: of x where it is false, of y where it is true.
    """
    bins = (len(raw) + 1) // 3
    share = 2 - 2 * MINIMUM * bins
    steps = []
    for logits in (raw[:bins], raw[bins : 2 * bins]):
        top = logits[0]
        for v in logits[1:]:
            top = dr.maximum(top, v)
        exps = [dr.exp(v - top) for v in logits]
        total = exps[0]
        for v in exps[1:]:
            total = total + v
        scale = share * dr.rcp(total)
        steps.append([dr.fma(v, scale, 2 * MINIMUM) for v in exps])
    half = bins // 2
    # Knots from -1 up to the middle, then from 1 down to it, as _summation has them.
    knots = []
    for size in steps:
        up = [type(value)(0)]
        for k in range(half):
            up.append(up[-1] + size[k])
        down = [type(value)(0)]
        for k in range(bins - 1, half, -1):
            down.append(down[-1] - size[k])
        knots.append(up + down[::-1])
    if isinstance(axis, int):
        along = knots[axis]
    else:
        along = [dr.select(axis, y, x) for x, y in zip(*knots, strict=True)]
    slopes = [type(value)(0), *raw[2 * bins :], type(value)(0)]
    found = [knots[0][0], knots[0][1], knots[1][0], knots[1][1], slopes[0], slopes[1]]
    anchor = -type(value)(1)
    below, above = value + 1, value - 1
    for k in range(1, bins):
        left = k <= half
        reached = along[k] <= (below if left else above)
        # The middle bin begins on one side and ends on the other.
        shift = 2 if k == half else 0
        here = [knots[0][k], knots[0][k + 1] + shift, knots[1][k], knots[1][k + 1] + shift]
        found = [
            dr.select(reached, new, old)
            for new, old in zip([*here, slopes[k], slopes[k + 1]], found, strict=True)
        ]
        if k == half + 1:
            anchor = dr.select(reached, 1, anchor)
    *corners, d0, d1 = found
    return Bin(anchor, *corners, derivative_columns(d0), derivative_columns(d1))


def warp_columns(raw: Columns, x: Float) -> tuple[Float, Float]:
    """``(y, dy/dx)`` at ``x``: :func:`warp` over columns."""
    return evaluate_columns(_find_columns(raw, x, 0), x)


def unwarp_columns(raw: Columns, y: Float) -> tuple[Float, Bin]:
    """``x``, the inverse, and the bin it is in."""
    b = _find_columns(raw, y, 1)
    return dr.select(dr.abs(y) < 1, _solve(b, y, dr.clip, dr.sqrt, dr.select), y), b


def unwarp_or_keep_columns(raw: Columns, y: Float, x: Float, keep: Bool) -> tuple[Float, Bin]:
    """:func:`unwarp_columns` of ``y``, but ``x`` itself and its bin where ``keep``."""
    b = _find_columns(raw, dr.select(keep, x, y), ~keep)
    solved = dr.select(dr.abs(y) < 1, _solve(b, y, dr.clip, dr.sqrt, dr.select), y)
    return dr.select(keep, x, solved), b


def evaluate_columns(b: Bin, x: Float) -> tuple[Float, Float]:
    """``(y, dy/dx)`` at an ``x`` whose bin is known.

    By the same arithmetic as :func:`warp_columns`: at the rounded result of
    :func:`unwarp_columns` it gives what a query of the density there will find.
    """
    inside = dr.abs(x) < 1
    y, s, numerator, d = _evaluate(b, x, dr.clip)
    ratio = s / d
    return dr.select(inside, y, x), dr.select(inside, ratio * ratio * numerator, 1)
