"""Adam as trainings of textures have it."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor


def adam(groups: Iterable[Iterable[Tensor]]) -> torch.optim.Adam:
    """One group of parameters for each of ``groups``; step sizes are set at every step.

    A texel is seen by few rows of a batch: its gradients are tiny and rare, so that nothing may be
    added to their root mean square, nor may that be remembered for a thousand steps.
    """
    parts = [{"params": list(group)} for group in groups]
    return torch.optim.Adam(parts, betas=(0.9, 0.99), eps=1e-15, fused=True)
