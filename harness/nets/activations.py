r"""Activations with their slopes, in torch and over columns.

``relu`` and ``leaky_relu`` (slope 0.01) are piecewise linear: a map made of them has a Jacobian
that jumps. ``silu``, :math:`v\,\sigma(v)`, is smooth and costs one exponential a neuron.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from harness.core.columns.bridge import Columns

SLOPES = {"relu": 0.0, "leaky_relu": 0.01}
"""Of the piecewise linear ones, left of zero."""
ACTIVATIONS = (*SLOPES, "silu")


def value(name: str, v: Tensor) -> Tensor:
    """The activation called ``name`` of each entry."""
    if name == "silu":
        return torch.nn.functional.silu(v)
    return torch.nn.functional.leaky_relu(v, SLOPES[name])


def push(name: str, v: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
    """The activation of ``v`` [...], and its derivatives along ``tangents`` [K, ...].

    At a kink the derivative is that of the negative side.
    """
    if name == "silu":
        return _PushedSilu.apply(v, tangents)
    slope = SLOPES[name]
    bend = torch.where(v > 0, 1.0, slope).to(v)
    return torch.nn.functional.leaky_relu(v, slope), bend * tangents


class _PushedSilu(torch.autograd.Function):
    """SiLU with derivatives beside it; its own gradients take half of what recorded ones do."""

    @staticmethod
    def forward(ctx: Any, v: Tensor, tangents: Tensor) -> tuple[Tensor, Tensor]:
        gate = torch.sigmoid(v)
        value = v * gate
        slope = torch.addcmul(gate, value, 1 - gate)
        ctx.save_for_backward(v, gate, slope, tangents)
        return value, slope * tangents

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_value: Tensor, by_tangents: Tensor) -> tuple[Tensor, Tensor]:
        v, gate, slope, tangents = ctx.saved_tensors
        # The second derivative: g (1 - g) (2 + v (1 - 2 g)).
        rest = 1 - gate
        bend = gate * rest * torch.addcmul(torch.full_like(v, 2), v, rest - gate)
        along = (by_tangents * tangents).sum(0)
        return torch.addcmul(by_value * slope, bend, along), slope * by_tangents


def value_columns(name: str, x: Columns) -> Columns:
    """:func:`value` over columns."""
    if name == "silu":
        return [v * _gate(v) for v in x]
    # Not max(v, 0), which would turn nan into 0.
    return [dr.maximum(v, SLOPES[name] * v) for v in x]


def with_slope_columns(name: str, x: Columns) -> tuple[Columns, Columns]:
    """:func:`with_slope` over columns."""
    if name != "silu":
        array = type(x[0])
        slopes = [dr.select(v > 0, array(1), array(SLOPES[name])) for v in x]
        return value_columns(name, x), slopes
    gates = [_gate(v) for v in x]
    out = [v * g for v, g in zip(x, gates, strict=True)]
    return out, [dr.fma(o, 1 - g, g) for o, g in zip(out, gates, strict=True)]


def _gate(v: Columns) -> Columns:
    """The logistic function; by tanh, which does not overflow."""
    return dr.fma(0.5, dr.tanh(0.5 * v), 0.5)
