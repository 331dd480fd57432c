"""One step of an ordinary differential equation by Euler, midpoint or Runge-Kutta's method.

Written over an ``add(x, h, k)`` that gives x + h k, so that tensors, columns and either with
derivatives beside them take the same steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

SOLVERS = {"euler": 1, "midpoint": 2, "rk4": 4}
"""How often a step evaluates the velocity."""

Field = Callable[[Any, Any], Any]
"""Velocity at a place and a time."""
Add = Callable[[Any, Any, Any], Any]


def step(solver: str, field: Field, add: Add, x: Any, t: Any, h: float) -> Any:
    """From ``x`` at time ``t`` to time ``t + h``; a negative h goes back."""
    first = field(x, t)
    if solver == "euler":
        return add(x, h, first)
    second = field(add(x, h / 2, first), t + h / 2)
    if solver == "midpoint":
        return add(x, h, second)
    third = field(add(x, h / 2, second), t + h / 2)
    fourth = field(add(x, h, third), t + h)
    for weight, k in ((1, first), (2, second), (2, third), (1, fourth)):
        x = add(x, h * weight / 6, k)
    return x
