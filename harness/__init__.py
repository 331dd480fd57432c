"""Compare importance-sampling methods for reflectance functions, in pdf quality and in renders.

Importing this package is cheap: its names are loaded when first used.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

from harness.core import allocator

# OpenMP threads that spin while they wait starve Dr.Jit's own threads. The variable is read
# once, when torch is imported, so it has to be set before that.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
allocator.keep()

if TYPE_CHECKING:
    from harness.analysis.results import load_results
    from harness.core.protocol.disk import square_to_disk
    from harness.core.protocol.errors import BudgetExceeded, InputError, StateRefused, Unsupported
    from harness.core.protocol.material import Material
    from harness.core.protocol.method import (
        Budget,
        DiskSample,
        FitReport,
        Knob,
        Method,
        WeightedSample,
    )

__version__ = "0.1.0"

__all__ = [
    "Budget",
    "BudgetExceeded",
    "DiskSample",
    "FitReport",
    "InputError",
    "Knob",
    "Material",
    "Method",
    "StateRefused",
    "Unsupported",
    "WeightedSample",
    "load_results",
    "square_to_disk",
]

_PROTOCOL = "harness.core.protocol"
_HOME = dict.fromkeys(__all__, f"{_PROTOCOL}.method") | {
    **dict.fromkeys(
        ("BudgetExceeded", "InputError", "StateRefused", "Unsupported"), f"{_PROTOCOL}.errors"
    ),
    "Material": f"{_PROTOCOL}.material",
    "load_results": "harness.analysis.results",
    "square_to_disk": f"{_PROTOCOL}.disk",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'harness' has no attribute '{name}'")
