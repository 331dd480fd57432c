"""``harness doctor``: what this machine can run, and what is missing.

Every check looks for itself and reports; none of them stops the others. What could end
the process (a trial render with an LLVM that aborts) runs in a process of its own.
"""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import typer

OK, NOTE, MISSING = "ok", "note", "missing"
OLDEST_PYTHON = (3, 11)
LITTLE_MEMORY = 4.0
"""GiB; less is worth a note, since PyTorch, Mitsuba and LLVM share it with the data."""
TRIAL_SECONDS = 120

TRIAL_RENDER = """
import sys
import drjit as dr
import mitsuba as mi
mi.set_variant(sys.argv[1])
look = mi.ScalarTransform4f().look_at([0, -4, 0], [0, 0, 0], [0, 0, 1])
film = {'type': 'hdrfilm', 'width': 8, 'height': 8}
image = mi.render(mi.load_dict({
    'type': 'scene', 'integrator': {'type': 'path', 'max_depth': 3},
    'sensor': {'type': 'perspective', 'to_world': look, 'film': film},
    'ball': {'type': 'sphere', 'bsdf': {'type': 'principled'}},
    'light': {'type': 'constant'}}), spp=4)
dr.eval(image)
dr.sync_thread()
"""


@dataclass(frozen=True)
class Finding:
    """One row of the table: what was looked for, what is there, what to do about it."""

    name: str
    found: str
    status: str = OK
    advice: str = ""


def python() -> Finding:
    """The interpreter."""
    found = f"{platform.python_version()} ({sys.executable})"
    if sys.version_info[:2] < OLDEST_PYTHON:
        wanted = ".".join(map(str, OLDEST_PYTHON))
        return Finding("Python", found, MISSING, f"use Python {wanted} or newer")
    return Finding("Python", found)


def gpu_driver() -> str | None:
    """Name of the first NVIDIA GPU as its driver tells it, or None."""
    if shutil.which("nvidia-smi") is None:
        return None
    query = ["nvidia-smi", "--query-gpu=name,memory.total", "--format=csv,noheader"]
    reply = subprocess.run(query, capture_output=True, text=True, timeout=30, check=False)
    lines = reply.stdout.strip().splitlines()
    return lines[0] if reply.returncode == 0 and lines else None


def _imported(name: str) -> ModuleType | str:
    """A module, or why it cannot be imported (OSError: a shared library of it is missing)."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        return str(error).splitlines()[0]


def _package(title: str, name: str, detail: Callable[[ModuleType], str]) -> Finding:
    module = _imported(name)
    if isinstance(module, str):
        return Finding(title, module, MISSING, "run scripts/with-env once, it installs it")
    return Finding(title, f"{module.__version__}, {detail(module)}")


def torch() -> Finding:
    """PyTorch, and whether it can use a GPU."""

    def detail(module: ModuleType) -> str:
        if not module.cuda.is_available():
            return "CPU only"
        return f"CUDA {module.version.cuda} on {module.cuda.get_device_name(0)}"

    return _package("PyTorch", "torch", detail)


def drjit() -> Finding:
    """Dr.Jit and its back ends."""

    def detail(module: ModuleType) -> str:
        kinds = {"LLVM": module.JitBackend.LLVM, "CUDA": module.JitBackend.CUDA}
        usable = [name for name, kind in kinds.items() if module.has_backend(kind)]
        return f"back ends: {', '.join(usable) or 'none'}"

    return _package("Dr.Jit", "drjit", detail)


def mitsuba() -> Finding:
    """Mitsuba and those of its variants that the harness uses."""
    from harness.mitsuba_runtime.variant import VARIANTS

    def detail(module: ModuleType) -> str:
        built = [v for v in VARIANTS.values() if v in module.variants()]
        return f"variants: {', '.join(built) or 'none of ' + ', '.join(VARIANTS.values())}"

    return _package("Mitsuba", "mitsuba", detail)


def llvm() -> Finding:
    """The LLVM library that compiles for the CPU."""
    from harness.mitsuba_runtime import llvm as probe

    if isinstance(_imported("drjit"), str):
        return Finding("LLVM", "not looked for: no Dr.Jit", MISSING)
    library = probe.loaded()
    trouble = probe.problem(library)
    if trouble:
        return Finding("LLVM", trouble, MISSING, probe.remedy(probe.others()))
    return Finding("LLVM", str(library))


def gpu() -> Finding:
    """An NVIDIA GPU: never needed, much faster."""
    name = gpu_driver()
    if name is None:
        return Finding("GPU", "none", NOTE, "not needed; the full profile is meant for one")
    module = _imported("torch")
    if not isinstance(module, str) and not module.cuda.is_available():
        return Finding("GPU", name, NOTE, "PyTorch is a CPU build: fits will not use this GPU")
    return Finding("GPU", name)


def compiler() -> Finding:
    """A C++ compiler, for the compiled kernels and ``torch.compile``."""
    for command in filter(None, (os.environ.get("CXX"), "c++", "g++", "clang++")):
        if path := shutil.which(command):
            return Finding("C++ compiler", path)
    advice = "not needed, but networks run faster with one; Debian, Ubuntu: apt-get install g++"
    return Finding("C++ compiler", "none", NOTE, advice)


def kernels() -> Finding:
    """The compiled kernels of networks over columns; built if they can be."""
    from harness.core.compiled import library
    from harness.core.protocol.errors import InputError

    try:
        reason = library.why_not()
    except InputError as error:
        return Finding("Compiled kernels", str(error), NOTE)
    if reason:
        return Finding("Compiled kernels", f"none: {reason}", NOTE, library.WITHOUT)
    return Finding("Compiled kernels", library.name())


def cores() -> Finding:
    """Processor cores that this process may use."""
    return Finding("Cores", f"{len(os.sched_getaffinity(0))} of {os.cpu_count()}")


def memory() -> Finding:
    """Main memory."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    if total < LITTLE_MEMORY:
        return Finding("Memory", f"{total:.1f} GiB", NOTE, "the quick profile may not fit")
    return Finding("Memory", f"{total:.0f} GiB")


def trial_render(variant: str) -> Finding:
    """Render a few pixels with ``variant`` in another process."""
    name, start = f"Trial render, {variant}", time.perf_counter()
    command = [sys.executable, "-c", TRIAL_RENDER, variant]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TRIAL_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return Finding(name, f"no image after {TRIAL_SECONDS} s", MISSING)
    if done.returncode < 0:
        found = f"process ended by signal {-done.returncode}"
        return Finding(name, found, MISSING, "try another release of LLVM, or of the driver")
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return Finding(name, last, MISSING)
    return Finding(name, f"{time.perf_counter() - start:.1f} s with start-up")


def examine() -> tuple[list[Finding], bool]:
    """All findings, and whether the main job can run (on the CPU or on a GPU)."""
    needed = [python(), torch(), drjit(), mitsuba()]
    library = llvm()
    rows = [*needed, library, gpu(), compiler(), cores(), memory()]
    if all(row.status == OK for row in needed):
        rows.append(kernels())
    renders: list[Finding] = []
    if all(row.status == OK for row in needed):
        from harness.mitsuba_runtime.variant import VARIANTS

        # A library known to abort is not tried.
        if library.status == OK:
            renders.append(trial_render(VARIANTS["cpu"]))
        if gpu_driver() is not None:
            renders.append(trial_render(VARIANTS["cuda"]))
    return rows + renders, any(row.status == OK for row in renders)


def show(rows: list[Finding], able: bool) -> None:
    """Print the table and the verdict."""
    from rich.table import Table
    from rich.text import Text

    from harness.core.terminal import Screen

    colours = {OK: "green", NOTE: "yellow", MISSING: "bold red"}
    table = Table(box=None, pad_edge=False)
    for heading in ("", "status", "found"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        status = Text(row.status, style=colours[row.status])
        table.add_row(row.name, status, Text(row.found))
        if row.advice:
            table.add_row("", "", Text(f"-> {row.advice}", style="italic"))
    console = Screen(highlight=False)
    console.print(table)
    if able:
        console.print("This machine can run the main job: harness run suites/table2.yaml")
    else:
        console.print("This machine cannot render: see the rows marked 'missing'.")


def register(app: typer.Typer) -> None:
    """Add the verb to ``app``."""

    @app.command("doctor")
    def doctor() -> None:
        """What this machine can run, and what is missing."""
        rows, able = examine()
        show(rows, able)
        raise typer.Exit(0 if able else 1)
