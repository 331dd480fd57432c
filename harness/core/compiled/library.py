"""The compiled kernels, loaded once for a process; or why there are none."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import drjit as dr
import numpy as np

from harness.core.compiled import build
from harness.core.compiled.instruction_sets import chosen

FALLBACK = "drjit"
"""What runs the networks where there are no compiled kernels."""
WITHOUT = "networks take two to three times as long on the CPU"
"""What that means."""


@dataclass(frozen=True)
class Library:
    """``name`` of the instruction set; seconds to build, next to none where it was there, and to
    load."""

    name: str
    build_seconds: float
    load_seconds: float
    pack: ctypes._CFuncPtr
    network: ctypes._CFuncPtr
    couplings: ctypes._CFuncPtr
    flow: ctypes._CFuncPtr
    transpose: ctypes._CFuncPtr
    functions: ctypes._CFuncPtr
    submit: int | None
    wait: int | None

    def elementary(self, v: np.ndarray) -> tuple[np.ndarray, ...]:
        """Exponential, sine, cosine, logistic function and hyperbolic tangent of the kernels.

        Of float32 [a multiple of 64].
        """
        out = tuple(np.empty_like(v) for _ in range(5))
        places = [ctypes.c_void_p(a.ctypes.data) for a in (v, *out)]
        self.functions(places[0], ctypes.c_int32(v.size), *places[1:])
        return out


@lru_cache(maxsize=1)
def found() -> Library | str:
    """The library for this processor, or one line that says why there is none.

    Raises:
        InputError: the environment variable names what is not there.
    """
    target = chosen()
    if isinstance(target, str):
        return target
    start = time.perf_counter()
    try:
        file = build.library(target)
        return opened(file, target.name, time.perf_counter() - start)
    except build.BuildFailed as error:
        return str(error)
    except OSError as error:
        return f"the library does not load: {error}"


def opened(file: Path, name: str, build_seconds: float) -> Library:
    """A compiled library that took ``build_seconds``.

    Raises:
        OSError: it cannot be loaded.
    """
    start = time.perf_counter()
    loaded = ctypes.CDLL(str(file))
    for name_of in ("pack", "network", "couplings", "flow", "transpose", "functions"):
        getattr(loaded, f"harness_{name_of}").restype = None
    submit, wait = _pool()
    return Library(
        name=name,
        build_seconds=build_seconds,
        load_seconds=time.perf_counter() - start,
        pack=loaded.harness_pack,
        network=loaded.harness_network,
        couplings=loaded.harness_couplings,
        flow=loaded.harness_flow,
        transpose=loaded.harness_transpose,
        functions=loaded.harness_functions,
        submit=submit,
        wait=wait,
    )


def name() -> str:
    """What runs networks over columns on this machine's CPU: an instruction set, or Dr.Jit."""
    library = found()
    return FALLBACK if isinstance(library, str) else library.name


def why_not() -> str:
    """One line that says why there are no compiled kernels; empty where there are."""
    library = found()
    return library if isinstance(library, str) else ""


def _pool() -> tuple[int | None, int | None]:
    """Addresses of Dr.Jit's own thread pool, so that both use the same threads.

    Without, everything runs in the calling thread.
    """
    for file in Path(dr.__file__).parent.glob("*nanothread*"):
        try:
            pool = ctypes.CDLL(str(file))
            return tuple(
                ctypes.cast(getattr(pool, symbol), ctypes.c_void_p).value
                for symbol in ("task_submit_dep", "task_wait_and_release")
            )
        except (OSError, AttributeError):
            continue
    return None, None
