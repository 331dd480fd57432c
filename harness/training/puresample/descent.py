"""Adam for some steps, its rate rising shortly and falling as a cosine."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import torch
from torch import Tensor

Notify = Callable[[str, float], None]
"""``notify(what is being done, share of it)``."""


def descend(
    loss: Callable[[], Tensor],
    groups: Iterable[tuple[Iterable[Tensor], float]],
    steps: int,
    notify: Notify,
    what: str,
) -> float:
    """``steps`` of Adam on ``loss()``; ``groups`` are (parameters, rate). The last loss.

    Raises:
        FloatingPointError: the loss became nan or infinite.
    """
    rates, parts = [], []
    for parameters, rate in groups:
        parts.append({"params": list(parameters)})
        rates.append(rate)
    # A texel is seen by few rows of a batch: nothing may be added to its gradients' mean square.
    optimiser = torch.optim.Adam(parts, betas=(0.9, 0.99), eps=1e-15, fused=True)
    every, rise, value = max(1, steps // 50), max(1, steps // 20), math.nan
    for step in range(steps):
        share = min((step + 1) / rise, 0.5 * (1 + math.cos(math.pi * step / steps)))
        for group, rate in zip(optimiser.param_groups, rates, strict=True):
            group["lr"] = rate * share
        found = loss()
        optimiser.zero_grad(set_to_none=True)
        found.backward()
        optimiser.step()
        if step % every == 0 or step + 1 == steps:
            value = float(found.detach())
            if not math.isfinite(value):
                raise FloatingPointError(f"{what}: loss is {value} at step {step}")
            notify(f"{what}, loss {value:.4f}", (step + 1) / steps)
    return value
