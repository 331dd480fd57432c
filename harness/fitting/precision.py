"""Weights rounded to bfloat16: half the bytes on disk.

Measured with Dr.Jit 1.5 on its LLVM back end, cooperative vectors in half precision take two to
three times as long as in single (CPUs have no arithmetic of that kind), bfloat16 ones do not exist.
So the numbers are rounded and stored short, and computed with in single precision: this saves
size, not time.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from harness.core.protocol.errors import InputError

PRECISIONS = ("bfloat16", "float32")


def checked_precision(precision: str, name: str) -> str:
    """``precision``, if it is one of :data:`PRECISIONS`."""
    if precision not in PRECISIONS:
        raise InputError(f"{name}: precision is '{precision}'; expected 'float32' or 'bfloat16'")
    return precision


@torch.no_grad()
def round_weights(module: nn.Module, precision: str) -> None:
    """Round the fitted numbers of ``module`` in place; what was not fitted (buffers) stays."""
    if precision == "bfloat16":
        for weight in module.parameters():
            weight.copy_(weight.bfloat16())


def shortened(module: nn.Module, precision: str) -> dict[str, Tensor]:
    """State of ``module`` as it is stored: fitted numbers in ``precision``, the rest as it is.

    Weights that were rounded lose nothing by it; a state dict of bfloat16 loads into single
    precision exactly.
    """
    state = {key: value.detach().cpu() for key, value in module.state_dict().items()}
    if precision == "bfloat16":
        for key, _ in module.named_parameters():
            state[key] = state[key].bfloat16()
    return state
