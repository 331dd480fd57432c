"""Which instruction sets the kernels are written for, and which this processor has."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from harness.core.protocol.errors import InputError, nearest

VARIABLE = "HARNESS_KERNELS"
"""Environment variable: ``auto``, ``off``, or the name of an instruction set."""


@dataclass(frozen=True)
class InstructionSet:
    """``needs`` are a processor's flags by Linux's names; ``options`` go to the compiler."""

    name: str
    machines: tuple[str, ...]
    needs: frozenset[str]
    options: tuple[str, ...]


_X86 = ("x86_64", "amd64")
SETS = (
    InstructionSet(
        "avx512",
        _X86,
        frozenset({"avx512f", "avx512dq", "avx512bw", "avx512vl", "fma"}),
        ("-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl", "-mfma",
         "-mprefer-vector-width=512", "-DWIDTH=16", "-DPACKETS=4", "-DOUTPUTS=4"),
    ),
    InstructionSet(
        "avx2",
        _X86,
        frozenset({"avx2", "fma"}),
        ("-mavx2", "-mfma", "-DWIDTH=8", "-DPACKETS=2", "-DOUTPUTS=6"),
    ),
    InstructionSet(
        "neon",
        ("aarch64", "arm64"),
        frozenset(),
        ("-DWIDTH=4", "-DPACKETS=4", "-DOUTPUTS=6"),
    ),
)  # fmt: skip
"""The fastest first. All have fused multiply-adds: without, results would be rounded otherwise."""


def wanted() -> str:
    """What the environment asks for: ``auto``, ``off`` or a name.

    Raises:
        InputError: none of these.
    """
    known = ("auto", "off", *(each.name for each in SETS))
    found = os.environ.get(VARIABLE, "") or "auto"
    if found not in known:
        raise InputError(
            f"environment variable {VARIABLE} is '{found}'; expected one of"
            f" {', '.join(known)}{nearest(found, known)}"
        )
    return found


def available() -> list[InstructionSet]:
    """Those that this processor has."""
    machine = platform.machine().lower()
    return [each for each in SETS if machine in each.machines and each.needs <= flags()]


def chosen() -> InstructionSet | str:
    """The instruction set to use, or why there is none.

    Raises:
        InputError: :data:`VARIABLE` names one that this processor has not.
    """
    name = wanted()
    if name == "off":
        return f"switched off by {VARIABLE}=off"
    here = available()
    if name != "auto":
        for each in here:
            if each.name == name:
                return each
        has = ", ".join(each.name for each in here) or "none of them"
        raise InputError(
            f"environment variable {VARIABLE} is '{name}', which this processor lacks; it has {has}"
        )
    if here:
        return here[0]
    machine = platform.machine().lower()
    names = " or ".join(each.name for each in SETS if machine in each.machines)
    return f"this processor ({machine}) has not {names}" if names else f"not written for {machine}"


@lru_cache(maxsize=1)
def flags(info: Path = Path("/proc/cpuinfo")) -> frozenset[str]:
    """What the processor can do; nothing where the system does not tell."""
    try:
        text = info.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return frozenset()
    for line in text.splitlines():
        if line.startswith("flags"):
            return frozenset(line.partition(":")[2].split())
    return frozenset()
