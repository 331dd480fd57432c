"""A table of the time of a material learned from walks."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch
from rich.table import Table
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import square_to_disk
from harness.materials.puresample import files, sampling
from harness.materials.puresample.network import CHANNELS, at_columns
from harness.stats.intervals import median_interval


def table(file: Path, rows: int, rounds: int, device: str = "cpu") -> Table:
    """Medians with 95 % intervals over interleaved rounds.

    ``f, published density`` has explicit steps back in place of the inversion: what exactness costs
    is the ratio of the two.
    """
    import drjit as dr

    material = files.make(file.stem, file, {})
    network = material.network.to(device)
    random = torch.Generator().manual_seed(0)
    condition = material.conditions(rows, random, device)
    wo = square_to_disk(torch.rand(rows, 2, generator=random)).to(device)
    u = torch.rand(rows, 3, generator=random).to(device)

    def published() -> Tensor:
        c, at = columns_of(condition), columns_of(wo)
        index, found = dr.uint32_array_t(type(c[0])), []
        for k in range(1 if network.architecture.grey else CHANNELS):
            conditioned = at_columns(network, c[:-2], index(k), c[-2:])
            found.append(sampling.published_density(network, conditioned, at))
        return tensor_of(*found, rows=rows)

    def brightest() -> Tensor:
        c = columns_of(condition)
        found = material.channel_sample_columns(c, columns_of(u), material.brightest_columns(c))
        return tensor_of(*found, rows=rows)

    def mixture() -> Tensor:
        found = material.native_sample_columns(columns_of(condition), columns_of(u))
        return tensor_of(*found, rows=rows)

    work: dict[str, Callable[[], Tensor]] = {
        "f": lambda: material.eval(condition, wo),
        "f, published density": published,
        "sample, highest channel": brightest,
        "sample, mixture": mixture,
    }
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for number in range(rounds + 1):
        for name, run in work.items():
            start = time.perf_counter()
            run()
            if number:  # the first compiles
                seconds[name].append(time.perf_counter() - start)
    steps = network.architecture.steps
    found = Table(
        title=f"{material.name}: {rows:,} directions on {device}, {steps} steps",
        caption=f"exact density: {_ratio(seconds):.2f} times the published one's time",
    )
    for name in ("", "ms", "95 % interval", "thousand rows/s"):
        found.add_column(name, justify="right" if name else "left")
    for name, taken in seconds.items():
        middle, low, high = (1e3 * x for x in median_interval(taken))
        found.add_row(name, f"{middle:.1f}", f"[{low:.1f}, {high:.1f}]", f"{rows / middle:.1f}")
    return found


def _ratio(seconds: dict[str, list[float]]) -> float:
    """Median over rounds, so that a slow spell slows both."""
    pairs = zip(seconds["f"], seconds["f, published density"], strict=True)
    return float(torch.tensor([a / b for a, b in pairs]).median())
