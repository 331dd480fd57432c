r"""Mixtures of a uniform lobe and axis-aligned Gaussian lobes on the projected disk.

.. math:: p(\omega) = \frac{w_0}{\pi}\,[|\omega| < 1] + \sum_{l \ge 1} w_l\,
          \mathcal{N}(x; \mu_{lx}, \sigma_{lx})\,\mathcal{N}(y; \mu_{ly}, \sigma_{ly})

The uniform lobe is the Lambertian one: cosine-weighted on the hemisphere. The Gaussians
reach beyond the disk; what falls there is an invalid sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import drjit as dr
import torch
from torch import Tensor, nn

from harness.core.columns.bridge import Columns, Float

LOG_2PI = math.log(2 * math.pi)
_RANGE = 10.0
_START = -1.0


class Lobes(NamedTuple):
    """``log_weight`` [..., 1 + L] normalised; ``mean`` and ``log_sigma`` [..., L, 2]."""

    log_weight: Tensor
    mean: Tensor
    log_sigma: Tensor


class ColumnLobes(NamedTuple):
    """The same over columns: ``weight`` [1 + L], ``mean`` and ``log_sigma`` [L] of pairs."""

    weight: list[Float]
    mean: list[tuple[Float, Float]]
    log_sigma: list[tuple[Float, Float]]


def log_sigma(raw: Tensor) -> Tensor:
    """A network's output as log standard deviation.

    ``10 tanh(raw / 10)`` is the identity where lobes live and keeps sigma between 5e-5 and
    2e4 for any input, where single precision still squares it.
    """
    return _RANGE * torch.tanh(raw / _RANGE)


def log_weight(raw: Tensor) -> Tensor:
    """Log weights [..., 1 + L] that sum to one, from a network's outputs.

    Bounded like :func:`log_sigma` before they are normalised: plain logits far apart underflow,
    and where the Lambertian lobe's weight is zero, light is lost. No weight is below e^-20 of
    another's.
    """
    return torch.log_softmax(_RANGE * torch.tanh(raw / _RANGE), -1)


def start_narrow(last: nn.Linear, outputs: slice) -> None:
    """Have the given outputs of a network's last layer start as log sigmas around -1.

    A lobe that starts as wide as the disk loses to the Lambertian one at once, and its
    weight vanishes before it has narrowed on anything.
    """
    with torch.no_grad():
        last.bias[outputs] = _START


def log_sigma_columns(raw: Float) -> Float:
    """:func:`log_sigma` over a column."""
    return _RANGE * dr.tanh(raw * (1 / _RANGE))


def weight_columns(raw: Columns) -> Columns:
    """The exponential of :func:`log_weight` over columns."""
    return softmax_columns([_RANGE * dr.tanh(value * (1 / _RANGE)) for value in raw])


def softmax_columns(raw: Columns) -> Columns:
    """Normalised weights from logits, shifted by the largest so that none overflows."""
    top = raw[0]
    for value in raw[1:]:
        top = dr.maximum(top, value)
    exps = [dr.exp(value - top) for value in raw]
    total = exps[0]
    for value in exps[1:]:
        total = total + value
    scale = dr.rcp(total)
    return [value * scale for value in exps]


def log_prob(lobes: Lobes, wo: Tensor) -> Tensor:
    """Log density [..., D] at ``wo`` [..., D, 2] for lobes of shape [...]."""
    z = (wo[..., None, :] - lobes.mean[..., None, :, :]) * torch.exp(-lobes.log_sigma)[
        ..., None, :, :
    ]
    gaussian = -0.5 * z.square().sum(-1) - lobes.log_sigma.sum(-1)[..., None, :] - LOG_2PI
    inside = wo.square().sum(-1) < 1
    uniform = torch.where(inside, -math.log(math.pi), -math.inf)[..., None]
    return torch.logsumexp(torch.cat([uniform, gaussian], -1) + lobes.log_weight[..., None, :], -1)


def pdf_columns(lobes: ColumnLobes, wo: Columns) -> Float:
    """Density at ``wo``."""
    x, y = wo
    pdf = dr.select(dr.fma(x, x, y * y) < 1, lobes.weight[0] * (1 / math.pi), 0)
    for weight, (mx, my), (sx, sy) in zip(
        lobes.weight[1:], lobes.mean, lobes.log_sigma, strict=True
    ):
        zx, zy = (x - mx) * dr.exp(-sx), (y - my) * dr.exp(-sy)
        pdf = dr.fma(weight, dr.exp(-0.5 * dr.fma(zx, zx, zy * zy) - sx - sy - LOG_2PI), pdf)
    return pdf


def sample_columns(lobes: ColumnLobes, u: Columns) -> tuple[Float, Float, Float]:
    """``(x, y, pdf)``: ``u[0]`` picks the lobe, ``u[1:3]`` are radius and angle in it."""
    sin, cos = dr.sincos(2 * math.pi * u[2])
    # 1 - u is at least 2^-24: the logarithm is finite, and exact near its zero.
    normal = dr.sqrt(-2 * dr.log(1 - u[1]))
    disk = dr.sqrt(u[1])
    x, y = disk * cos, disk * sin
    threshold = lobes.weight[0]
    for i, ((mx, my), (sx, sy)) in enumerate(zip(lobes.mean, lobes.log_sigma, strict=True)):
        # Weights sum to one but for rounding: whatever is left belongs to the last lobe.
        here = u[0] >= threshold
        x = dr.select(here, dr.fma(normal * cos, dr.exp(sx), mx), x)
        y = dr.select(here, dr.fma(normal * sin, dr.exp(sy), my), y)
        if i + 1 < len(lobes.mean):
            threshold = threshold + lobes.weight[i + 1]
    return x, y, pdf_columns(lobes, [x, y])
