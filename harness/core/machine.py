"""What this machine is, as far as it decides how long something takes."""

from __future__ import annotations

import os
import platform
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

COUNTED_VERSIONS = ("torch", "mitsuba", "drjit")
NOTED_VERSIONS = (*COUNTED_VERSIONS, "numpy")


@lru_cache(maxsize=4)
def identity(device: str = "cpu") -> dict[str, Any]:
    """Processor and usable cores; for a device other than the CPU also its name."""
    found: dict[str, Any] = {"cpu": _cpu(), "cores": len(os.sched_getaffinity(0))}
    if device != "cpu":
        import torch

        found["gpu"] = torch.cuda.get_device_name(device) if torch.cuda.is_available() else ""
    return found


def describe(device: str = "cpu") -> dict[str, Any]:
    """The identity, with what else is good to know: system, Python, all versions."""
    return {
        "machine": {**identity(device), "os": f"{platform.system()} {platform.machine()}"},
        "python": platform.python_version(),
        "versions": versions(NOTED_VERSIONS, local=True),
        "kernels": kernels(),
        "device": device,
    }


def kernels() -> str:
    """What runs networks over columns on the CPU: compiled kernels, or Dr.Jit and why."""
    from harness.core.compiled import library

    made = library.found()
    if isinstance(made, str):
        return f"Dr.Jit; no compiled kernels: {made}"
    return f"compiled for {made.name}"


def kernel_seconds() -> dict[str, float]:
    """What compiling and loading the kernels took in this process; empty where there are none."""
    from harness.core.compiled import library

    made = library.found()
    if isinstance(made, str):
        return {}
    return {"build": round(made.build_seconds, 3), "load": round(made.load_seconds, 3)}


def versions(packages: tuple[str, ...] = COUNTED_VERSIONS, local: bool = False) -> dict[str, str]:
    """Installed versions, read without importing the packages.

    Without ``local``, a build tag such as ``+cpu`` is left off: it names where a wheel was
    made for and not another version.
    """
    found = {name: _version(name) for name in packages}
    return found if local else {k: v.partition("+")[0] for k, v in found.items()}


@lru_cache(maxsize=32)
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.lower().startswith(("model name", "hardware")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
