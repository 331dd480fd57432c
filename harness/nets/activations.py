r"""Activations with their slopes, in torch and over columns.

``relu`` and ``leaky_relu`` (slope 0.01) are piecewise linear: a map made of them has a Jacobian
that jumps. ``silu``, :math:`v\,\sigma(v)`, is smooth and costs one exponential a neuron.
"""

from __future__ import annotations

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns

SLOPES = {"relu": 0.0, "leaky_relu": 0.01}
"""Of the piecewise linear ones, left of zero."""
ACTIVATIONS = (*SLOPES, "silu")


def value(name: str, v: Tensor) -> Tensor:
    """The activation called ``name`` of each entry."""
    if name == "silu":
        return torch.nn.functional.silu(v)
    return torch.nn.functional.leaky_relu(v, SLOPES[name])


def with_slope(name: str, v: Tensor) -> tuple[Tensor, Tensor]:
    """The activation and its derivative; at a kink that of the negative side."""
    if name == "silu":
        gate = torch.sigmoid(v)
        out = v * gate
        return out, gate + out * (1 - gate)
    slope = SLOPES[name]
    return torch.nn.functional.leaky_relu(v, slope), torch.where(v > 0, 1.0, slope).to(v)


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
