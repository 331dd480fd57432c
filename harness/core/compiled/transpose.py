"""Rows to columns, in memory."""

from __future__ import annotations

import ctypes

import numpy as np
import torch
from torch import Tensor

from harness.core.compiled.library import found


def transposed(rows: Tensor) -> Tensor:
    """``rows`` [N, C], float32 on the CPU, as a contiguous [C, N]."""
    n, count = rows.shape
    out = torch.empty(count, n)
    library = found()
    if isinstance(library, str) or rows.stride(1) != 1:
        # Twice as fast as torch's own copy.
        np.copyto(out.numpy(), rows.numpy().T)
        return out
    library.transpose(
        ctypes.c_void_p(rows.data_ptr()),
        ctypes.c_int64(rows.stride(0)),
        ctypes.c_uint32(n),
        ctypes.c_uint32(count),
        ctypes.c_void_p(out.data_ptr()),
        ctypes.c_void_p(library.submit),
        ctypes.c_void_p(library.wait),
    )
    return out
