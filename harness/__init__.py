"""Compare importance-sampling methods for reflectance functions, in pdf quality and in renders.

Importing this package is cheap: its names are loaded when first used.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from harness import allocator

# OpenMP threads that spin while they wait starve Dr.Jit's own threads. The variable is read
# once, when torch is imported, so it has to be set before that.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
allocator.keep()

if TYPE_CHECKING:
    from harness.protocol import Budget, DiskSample, FitReport, Material, Method
    from harness.store import load_results

__version__ = "0.1.0"
__all__ = ["Budget", "DiskSample", "FitReport", "Material", "Method", "load_results"]

_HOME = dict.fromkeys(__all__, "harness.protocol") | {"load_results": "harness.store"}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'harness' has no attribute '{name}'")
