"""States of a network whose outputs are held at a chosen value, whatever the input."""

from __future__ import annotations

from torch import Tensor

FAR = 100.0
"""An output past which every bounded parameter (10 tanh(x / 10)) is at the end of its range."""


def held(state: dict[str, Tensor], layer: str, rows: slice, value: float) -> dict[str, Tensor]:
    """``state`` with outputs ``rows`` of the linear layer called ``layer`` equal to ``value``.

    A copy where it differs; ``state`` is left alone.
    """
    weight, bias = state[f"{layer}.weight"].clone(), state[f"{layer}.bias"].clone()
    weight[rows], bias[rows] = 0, value
    return {**state, f"{layer}.weight": weight, f"{layer}.bias": bias}
