r"""A small uniform share beside a density that may vanish where its target does not.

.. math:: p(\omega) = (1 - \varepsilon)\,q(\omega) + \frac{\varepsilon}{\pi}\,[|\omega| < 1]

A flow's tails are its base Gaussian's: far from the lobe q underflows to zero or misses p* by
many powers of ten, and a few samples there carry the whole estimate. With a share of the
uniform disk no weight exceeds :math:`\pi f / \varepsilon`, for one sample in a hundred.
After Hesterberg (1995), Weighted Average Importance Sampling and Defensive Mixture
Distributions.
"""

from __future__ import annotations

import math

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError


def checked_share(share: float, name: str) -> float:
    """``share``, if it is one: 0 <= share < 1. Zero leaves the density as it is."""
    if not 0 <= share < 1:
        raise InputError(f"{name}: uniform is {share}; expected 0 <= uniform < 1")
    return share


def log_mixed(log_prob: Tensor, wo: Tensor, share: float) -> Tensor:
    """Log of the mixture, [...], from log q [...] at ``wo`` [..., 2]."""
    if share == 0:
        return log_prob
    uniform = math.log(share / math.pi)
    lit = torch.logaddexp(log_prob + math.log1p(-share), torch.full_like(log_prob, uniform))
    return torch.where(inside_disk(wo), lit, log_prob + math.log1p(-share))


def log_mixed_logit(log_prob: Tensor, wo: Tensor, raw: Tensor, least: float) -> Tensor:
    """:func:`log_mixed` with the share ``least + (1 - least) sigmoid(raw)``, ``raw`` [..., 1]."""
    # In logarithms, so that a share near 0 or 1 keeps its gradient.
    rest = torch.nn.functional.logsigmoid(-raw) + math.log1p(-least)
    part = torch.nn.functional.logsigmoid(raw) + math.log1p(-least)
    if least > 0:
        part = torch.logaddexp(part, torch.full_like(part, math.log(least)))
    lit = torch.logaddexp(log_prob + rest, (part - math.log(math.pi)).expand_as(log_prob))
    return torch.where(inside_disk(wo), lit, log_prob + rest)


def share_columns(raw: Float, least: float) -> Float:
    """That share over a column; by tanh, which does not overflow."""
    return dr.fma(0.5 * (1 - least), dr.tanh(0.5 * raw), 0.5 * (1 + least))


def mixed_columns(pdf: Float, wo: Columns, share: Float | float) -> Float:
    """The mixture's density from q at ``wo``."""
    x, y = wo
    uniform = dr.select(dr.fma(x, x, y * y) < 1, type(x)(share / math.pi), 0)
    return dr.fma(1 - share, pdf, uniform)


def uniform_disk_columns(u: Columns) -> tuple[Float, Float]:
    """A point of the uniform disk from two uniforms: squared radius and angle."""
    sin, cos = dr.sincos(2 * math.pi * u[1])
    radius = dr.sqrt(u[0])
    return radius * cos, radius * sin
