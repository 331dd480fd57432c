"""Which LLVM Dr.Jit would compile with, and whether it can be used.

Dr.Jit loads ``libLLVM`` when it is first asked to compile for the CPU. Releases 15 and 16
lack an instruction that its kernels need (llvm-project issue 53353), and LLVM answers
that by ending the process: no exception, no message of ours. So the version is asked for
first, which launches no kernel.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from harness.core.protocol.errors import InputError

OLDEST = 17
"""The oldest major release that compiles Dr.Jit's kernels."""
TESTED = 19
"""The major release that the harness is developed with; others are ranked by closeness."""
PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Names the library to load. Dr.Jit reads it once, when it is imported."""

PLACES = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64/llvm*/lib*",
    "/usr/local/lib",
    f"{sys.prefix}/lib",
)


@dataclass(frozen=True)
class Library:
    """A ``libLLVM``: its version (None if there is none) and its file (None if unknown)."""

    version: tuple[int, int, int] | None
    path: str | None = None

    def __str__(self) -> str:
        if self.version is None:
            return "none"
        return ".".join(map(str, self.version)) + (f" ({self.path})" if self.path else "")


def loaded() -> Library:
    """The library that Dr.Jit uses in this process, loading it if need be."""
    import drjit as dr

    version = tuple(dr.detail.llvm_version())
    if version[0] < 0:
        return Library(None)
    return Library(version, _mapped_file())


def _mapped_file() -> str | None:
    """The file from which libLLVM was mapped into this process (Linux; else None)."""
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return None
    for line in maps.read_text().splitlines():
        path = line.rpartition(" ")[2]
        if Path(path).name.startswith("libLLVM"):
            return path
    return None


def others(places: tuple[str, ...] = PLACES) -> list[Library]:
    """Usable libraries found in the usual places, the one closest to the tested first."""
    found: dict[str, Library] = {}
    for place in (*places, *_conda_places()):
        # Path.glob refuses absolute patterns, hence the detour over the root.
        for path in sorted(Path("/").glob(f"{place.lstrip('/')}/libLLVM*.so*")):
            match = re.fullmatch(r"libLLVM(?:-|\.so\.)(\d+).*", path.name)
            if match and int(match[1]) >= OLDEST and path.is_file():
                real = str(path.resolve())
                found.setdefault(real, Library((int(match[1]), 0, 0), real))
    return sorted(found.values(), key=lambda lib: (abs(lib.version[0] - TESTED), lib.path))


def _conda_places() -> tuple[str, ...]:
    prefix = os.environ.get("CONDA_PREFIX")
    return (f"{prefix}/lib",) if prefix else ()


def problem(library: Library) -> str | None:
    """Why Dr.Jit cannot use ``library``, or None if it can."""
    if library.version is None:
        named = os.environ.get(PATH_VARIABLE)
        if named:
            return f"LLVM cannot be loaded from {PATH_VARIABLE}={named}"
        return "no LLVM library found"
    if library.version[0] < OLDEST:
        return f"LLVM {library} is too old: Dr.Jit's kernels need {OLDEST} or newer"
    return None


def remedy(usable: list[Library]) -> str:
    """What to do about a missing or unusable library, given those that would do."""
    if usable:
        return f"export {PATH_VARIABLE}={usable[0].path}"
    return (
        f"install LLVM {OLDEST} or newer (Debian, Ubuntu: apt-get install libllvm{TESTED}; "
        "Fedora, Arch: package llvm-libs; conda-forge: libllvm) or set "
        f"{PATH_VARIABLE} to its libLLVM.so"
    )


def require() -> Library:
    """The library in use; :class:`InputError` with what to do if it cannot be used."""
    library = loaded()
    trouble = problem(library)
    if trouble:
        raise InputError(f"{trouble}; {remedy(others())}")
    return library


def main() -> int:
    """For the set-up script: print what to put into the path variable, if anything.

    Exit status 0: Dr.Jit's own choice works, nothing printed. 3: it does not, but the
    printed file does. 1: nothing on this machine does; the reason is on standard error.
    """
    trouble = problem(loaded())
    if not trouble:
        return 0
    usable = others()
    if usable:
        print(usable[0].path)
        return 3
    print(f"{trouble}; {remedy(usable)}", file=sys.stderr)
    return 1
