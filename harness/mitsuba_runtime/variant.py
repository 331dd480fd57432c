"""The one place that sets Mitsuba's variant, after making sure that it can run."""

from __future__ import annotations

import sys
from types import ModuleType

from harness.core.protocol.errors import InputError, nearest
from harness.mitsuba_runtime import llvm

VARIANTS = {"cpu": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}


def use(device: str) -> ModuleType:
    """Mitsuba, set to compile for ``device`` (``cpu`` or ``cuda``).

    Call it before the first kernel. One process keeps one variant: plugins, textures and
    samplers that were registered or built under one are of no use under another, so a
    second, different device is refused.
    """
    if device not in VARIANTS:
        raise InputError(f"unknown device '{device}'{nearest(device, VARIANTS)}")
    import mitsuba as mi

    wanted, current = VARIANTS[device], mi.variant()
    if current not in (None, wanted):
        raise InputError(
            f"device '{device}' needs Mitsuba's {wanted}, but this process already runs "
            f"{current}; start another process for it"
        )
    if device == "cpu":
        llvm.require()
    else:
        _require_cuda(mi)
    if current is None:
        mi.set_variant(wanted)
    return mi


def current() -> str:
    """The device that this process's Mitsuba compiles for: ``cpu`` until one is chosen."""
    mi = sys.modules.get("mitsuba")
    return "cuda" if mi is not None and mi.variant() == VARIANTS["cuda"] else "cpu"


def _require_cuda(mi: ModuleType) -> None:
    import drjit as dr

    if VARIANTS["cuda"] not in mi.variants():
        raise InputError(f"this build of Mitsuba has no {VARIANTS['cuda']}; use device 'cpu'")
    if not dr.has_backend(dr.JitBackend.CUDA):
        raise InputError(
            "device 'cuda' needs an NVIDIA GPU with its driver (try nvidia-smi), and Dr.Jit "
            "sees none; use device 'cpu'"
        )
