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
    from harness.api.pictures import render
    from harness.api.sampler import Sampler, fit
    from harness.api.subjects import material
    from harness.api.suites import load_sampler, run
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
    from harness.rendering.passes import evaluated_mode

__version__ = "0.1.0"

_PROTOCOL, _API = "harness.core.protocol", "harness.api"
_HOME = {
    "Budget": f"{_PROTOCOL}.method",
    "BudgetExceeded": f"{_PROTOCOL}.errors",
    "DiskSample": f"{_PROTOCOL}.method",
    "FitReport": f"{_PROTOCOL}.method",
    "InputError": f"{_PROTOCOL}.errors",
    "Knob": f"{_PROTOCOL}.method",
    "Material": f"{_PROTOCOL}.material",
    "Method": f"{_PROTOCOL}.method",
    "Sampler": f"{_API}.sampler",
    "StateRefused": f"{_PROTOCOL}.errors",
    "Unsupported": f"{_PROTOCOL}.errors",
    "WeightedSample": f"{_PROTOCOL}.method",
    "evaluated_mode": "harness.rendering.passes",
    "fit": f"{_API}.sampler",
    "load_results": "harness.analysis.results",
    "load_sampler": f"{_API}.suites",
    "material": f"{_API}.subjects",
    "render": f"{_API}.pictures",
    "run": f"{_API}.suites",
    "square_to_disk": f"{_PROTOCOL}.disk",
}
"""Where each public name is."""

__all__ = [  # noqa: F822 - loaded when first used
    "Budget",
    "BudgetExceeded",
    "DiskSample",
    "FitReport",
    "InputError",
    "Knob",
    "Material",
    "Method",
    "Sampler",
    "StateRefused",
    "Unsupported",
    "WeightedSample",
    "evaluated_mode",
    "fit",
    "load_results",
    "load_sampler",
    "material",
    "render",
    "run",
    "square_to_disk",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'harness' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
