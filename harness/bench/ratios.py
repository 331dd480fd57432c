"""What compiled kernels are to a method: beside Dr.Jit's code and beside PyTorch's."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from harness.bench.adapters import Rows
from harness.bench.interleaved import Work, interleaved
from harness.bench.profile import drawn, each_fitted
from harness.core import machine
from harness.core.compiled import library
from harness.core.protocol.method import Method
from harness.materials import registry as materials
from harness.mitsuba_runtime import variant
from harness.nets import compiled_network
from harness.stats.intervals import median_interval

BATCH = 1 << 14
"""Rows of a call; what PyTorch's activations of a network have in a CPU's cache."""
WAYS = ("compiled", "Dr.Jit", "PyTorch")


@contextlib.contextmanager
def without_kernels() -> Iterator[None]:
    """Networks are Dr.Jit's inside."""
    kept = compiled_network.found
    compiled_network.found = lambda: "not now"
    try:
        yield
    finally:
        compiled_network.found = kept


def works(method: Method, condition: Tensor, u: Tensor) -> dict[str, dict[str, Work]]:
    """``sample`` and ``pdf`` of ``method``, each by those of :data:`WAYS` that there are."""
    wo = method.sample(condition, u).wo
    found: dict[str, dict[str, Work]] = {}
    for what, arguments in (("sample", (condition, u)), ("pdf", (condition, wo))):
        run = getattr(method, what)

        def in_dr_jit(run: Work = run, arguments: tuple = arguments) -> object:
            with without_kernels():
                return run(*arguments)

        ways: dict[str, Work] = {"Dr.Jit": in_dr_jit}
        if not library.why_not():
            ways["compiled"] = lambda run=run, arguments=arguments: run(*arguments)
        if (twin := method.in_torch()) is not None:
            same = getattr(twin, what)
            ways["PyTorch"] = lambda same=same, arguments=arguments: same(*arguments)
        found[what] = ways
    return found


def run(
    names: list[str] | None,
    material_name: str,
    rounds: int,
    steps: int,
    notify: Callable[[str], None],
) -> Rows:
    """Fit briefly, then time every column method with and without compiled kernels, on the CPU.

    One thread; nanoseconds of the processor, which other work on the machine lengthens less than
    those of the wall. Ratios are of calls of the same round.
    """
    variant.use("cpu")
    material = materials.make(material_name)
    condition, u = drawn(material, BATCH)
    threads = dr.thread_count(), torch.get_num_threads()
    cells = []
    for name, method in each_fitted(names, material, steps, notify):
        notify(f"timing {name}")
        dr.set_thread_count(1)
        torch.set_num_threads(1)
        try:
            for what, ways in works(method, condition, u).items():
                cells.append([f"{name}, {what}", *_cells(interleaved(ways, rounds))])
        finally:
            dr.set_thread_count(threads[0])
            torch.set_num_threads(threads[1])
    return Rows(
        title=f"{material.name}: nanoseconds a row, medians of {rounds} rounds",
        caption=(
            f"{BATCH:,} rows a call, one thread; networks {machine.kernels()}; x: beside compiled"
        ),
        columns=["", *WAYS, "x Dr.Jit", "x PyTorch"],
        cells=cells,
    )


def _cells(seconds: dict[str, np.ndarray]) -> list[str]:
    cells = [f"{np.median(seconds[w]) / BATCH * 1e9:,.0f}" if w in seconds else "" for w in WAYS]
    for way in WAYS[1:]:
        if way not in seconds or "compiled" not in seconds:
            cells.append("")
            continue
        middle, low, high = median_interval(seconds[way] / seconds["compiled"])
        cells.append(f"{middle:.2f} [{low:.2f}, {high:.2f}]")
    return cells
