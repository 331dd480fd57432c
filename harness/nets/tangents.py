"""A network over columns together with its derivatives, by forward differentiation."""

from __future__ import annotations

import drjit as dr
import drjit.nn

from harness.core.columns.bridge import Columns
from harness.nets.mlp import MLP


def with_tangents(mlp: MLP, x: Columns, tangents: list[Columns]) -> tuple[Columns, list[Columns]]:
    """Outputs of ``mlp`` at ``x``, and their derivatives along each of ``tangents``.

    Each costs as much as the network itself. Where a hidden neuron is at its kink the
    derivative is that of its negative side.
    """
    array = type(x[-1])
    weights, biases = mlp.packed(array)
    last = len(weights) - 1
    for i, (w, b) in enumerate(zip(weights, biases, strict=True)):
        x = list(drjit.nn.matvec(w, drjit.nn.CoopVec(*x), b))
        tangents = [list(drjit.nn.matvec(w, drjit.nn.CoopVec(*t))) for t in tangents]
        if i < last:
            slope = [dr.select(v > 0, array(1), array(mlp.slope)) for v in x]
            # Not max(v, 0), which would turn nan into 0.
            x = [dr.maximum(v, mlp.slope * v) for v in x]
            tangents = [[s * v for s, v in zip(slope, t, strict=True)] for t in tangents]
    return x, tangents
