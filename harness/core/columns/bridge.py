"""Torch tensors as Dr.Jit columns and back."""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.compiled.transpose import transposed

Float = Any
"""A Dr.Jit 32-bit float array (``drjit.llvm.ad.Float`` or ``drjit.cuda.ad.Float``)."""

Columns = list[Float]
"""One array per input column, all of one length (or of length one: the same in all rows)."""


def backend(device: torch.device) -> Any:
    """The Dr.Jit module whose arrays live where a torch device's tensors do."""
    if device.type == "cuda":
        import drjit.cuda.ad as module
    else:
        import drjit.llvm.ad as module
    return module


def columns_of(rows: Tensor) -> Columns:
    """The columns of ``rows`` [N, C], N > 0, as C arrays.

    Shares memory where a column is contiguous already, copies it where it is not.
    """
    array = backend(rows.device).Float
    rows = rows.detach().float()
    if len(rows) > 1 and rows.stride(0) != 1 and rows.device.type == "cpu":
        rows = transposed(rows).T
    return [array(rows[:, i].contiguous()) for i in range(rows.shape[1])]


def tensor_of(*columns: Float, rows: int, by_columns: bool = False) -> Tensor:
    """Arrays as one tensor, [rows, len(columns)], or [rows] for a single array.

    ``by_columns`` stores it column by column, which is quicker, and :func:`columns_of` of it copies
    nothing; ``view`` may then refuse.
    """
    dr.eval(columns)
    dr.sync_thread()
    # clone: an output may be an input's own memory, and the caller owns what it gets.
    tensors = [c.torch().expand(rows) for c in columns]
    if len(tensors) == 1:
        return tensors[0].clone()
    return torch.stack(tensors).T if by_columns else torch.stack(tensors, -1)
