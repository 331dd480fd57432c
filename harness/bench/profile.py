"""Where the time of a sample goes: the parts of ``harness bench --profile``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from harness.bench.adapters import Rows
from harness.core import machine, registry
from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.columns.method import ColumnMethod
from harness.core.compiled import history
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.materials import registry as materials
from harness.mitsuba_runtime import variant

BATCH = 1 << 16
"""Rows of a call."""


@dataclass(frozen=True)
class Parts:
    """Nanoseconds of one row of ``sample``, medians over rounds.

    ``whole`` is the call, on tensors stored row by row. Parts of it: ``to_columns`` and ``to_rows``
    (between tensors and columns), ``network`` and ``spline`` (in compiled kernels), ``kernels``
    (Dr.Jit's: what is not in the two before, with lobes, search and tables; all of it where there
    are no compiled kernels), ``fixed`` (what a call of one row takes, over the rows of a batch:
    tracing, launches, Python). ``rest`` is what is left, negative where parts run side by side.
    ``memory`` is no part but a yardstick: reading every input column and writing every
    output column once.
    """

    whole: float
    to_columns: float
    to_rows: float
    network: float
    spline: float
    kernels: float
    fixed: float
    memory: float

    @property
    def rest(self) -> float:
        """Of the whole, what no part accounts for."""
        parts = self.to_columns + self.to_rows + self.network + self.spline + self.kernels
        return self.whole - parts - self.fixed


def measure(method: ColumnMethod, condition: Tensor, u: Tensor, rounds: int) -> Parts:
    """The parts of ``method.sample(condition, u)``; rounds are interleaved."""
    rows = len(condition)
    arrays = columns_of(condition), columns_of(u)
    found: list[list[float]] = []

    def compiled(work: Callable[[], object]) -> tuple[float, float]:
        """Seconds of networks and of splines in the compiled kernels."""
        with history.recorded() as runs:
            work()
        alone = [_seconds(run.again) for run in runs]
        spline = sum(r.seconds - s for r, s in zip(runs, alone, strict=True) if r.more)
        return sum(alone), spline

    for _ in range(rounds + 1):
        outputs = method.sample_columns(*arrays)
        dr.eval(outputs)
        network, spline = compiled(lambda: method.sample_columns(*arrays))
        whole = _seconds(lambda: method.sample(condition, u))
        found.append(
            [
                whole,
                _seconds(lambda: (columns_of(condition), columns_of(u))),
                _seconds(lambda outputs=outputs: tensor_of(*outputs, rows=rows, by_columns=True)),
                network,
                spline,
                _in_kernels(lambda: method.sample(condition, u)),
                _seconds(lambda: method.sample(condition[:1], u[:1])),
                _seconds(lambda outputs=outputs: [v + 1 for v in (*arrays[0], *arrays[1])]),
            ]
        )
    # The first round compiles.
    medians = np.median(np.array(found[1:]), 0) / rows * 1e9
    return Parts(*(float(v) for v in medians))


def run(
    names: list[str] | None,
    material_name: str,
    rounds: int,
    steps: int,
    notify: Callable[[str], None],
) -> Rows:
    """Fit briefly, then take every column method apart, on the CPU."""
    variant.use("cpu")
    material = materials.make(material_name)
    condition, u = drawn(material, BATCH)
    cells = []
    for name, method in each_fitted(names, material, steps, notify):
        notify(f"profiling {name}")
        parts = measure(method, condition, u, rounds)
        numbers = [getattr(parts, field.name) for field in fields(parts)]
        cells.append([name, *(f"{v:,.0f}" for v in [*numbers[:-1], parts.rest, numbers[-1]])])
    return Rows(
        title=f"{material.name}: nanoseconds a sample, medians of {rounds} rounds",
        caption=(
            f"{BATCH:,} rows a call, {dr.thread_count()} threads; networks {machine.kernels()};"
            " 'memory' is no part: reading inputs and writing outputs once"
        ),
        columns=[
            "method",
            "whole",
            "to columns",
            "to rows",
            "network",
            "spline",
            "Dr.Jit kernels",
            "fixed",
            "rest",
            "memory",
        ],
        cells=cells,
    )


def drawn(material: Material, rows: int) -> tuple[Tensor, Tensor]:
    """Conditions [rows, C], stored row by row, and uniforms [rows, 3]."""
    generator = torch.Generator().manual_seed(1)
    condition = material.conditions(rows, generator, "cpu").contiguous()
    return condition, torch.rand(rows, 3, generator=generator)


def each_fitted(
    names: list[str] | None, material: Material, steps: int, notify: Callable[[str], None]
) -> Iterator[tuple[str, ColumnMethod]]:
    """Column methods by name, by default all, after a short fit; a note says what is left out."""
    for name in names or registry.names():
        method = registry.make(name)
        supported, reason = method.supports(material)
        if not supported:
            notify(f"{name}: {reason}")
        elif not isinstance(method, ColumnMethod):
            notify(f"{name}: runs in PyTorch, one piece")
        else:
            notify(f"fitting {name}")
            budget = Budget(steps=steps, pool=256, device="cpu")
            method.fit(material, budget, torch.Generator().manual_seed(0))
            yield name, method


def _seconds(work: Callable[[], object]) -> float:
    """Of ``work()`` with its results computed."""
    dr.sync_thread()
    start = time.perf_counter()
    dr.eval(work())
    dr.sync_thread()
    return time.perf_counter() - start


def _in_kernels(work: Callable[[], object]) -> float:
    """Seconds in Dr.Jit's own kernels during ``work()``."""
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    dr.kernel_history_clear()
    try:
        work()
        dr.sync_thread()
        found = [e for e in dr.kernel_history() if e["type"] == dr.KernelType.JIT]
    finally:
        dr.kernel_history_clear()
        dr.set_flag(dr.JitFlag.KernelHistory, before)
    return sum(float(entry["execution_time"]) for entry in found) / 1e3
