"""Time of a neural material's two stages beside a bare network of its decoder's size."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.disk import square_to_disk
from harness.materials.neural.material import NeuralMaterial

CHUNK = 1 << 14
"""Rows that torch works on at a time where that is faster than all at once."""


@dataclass(frozen=True)
class Timing:
    """Seconds of every round, by what was timed."""

    rows: int
    seconds: dict[str, list[float]]

    def median(self, what: str) -> float:
        """Of all rounds."""
        return float(torch.tensor(self.seconds[what], dtype=torch.float64).median())

    @property
    def ratio(self) -> float:
        """Stage 2 over the bare network in its faster form."""
        return self.median("stage 2") / min(self.median("bare"), self.median("bare, in chunks"))


def run(material: NeuralMaterial, rows: int, rounds: int, device: str = "cpu") -> Timing:
    """Time, in interleaved rounds after one that does not count.

    ``stage 1`` makes ``rows`` conditions (offset and lookup), ``stage 2`` evaluates one direction
    for each, both with results in memory; ``bare`` is an ``nn.Sequential`` of the decoder's
    sizes on rows that are ready for it.
    """
    generator = torch.Generator().manual_seed(0)
    u = torch.rand(rows, 6, generator=generator).to(device)
    wi, wo = square_to_disk(u[:, 2:4]).contiguous(), square_to_disk(u[:, 4:])
    condition = material.condition_at(u[:, :2], wi)
    c, points = columns_of(condition), columns_of(wo)
    uv, seen = columns_of(u[:, :2]), columns_of(wi)
    a = material.network.architecture
    bare = _bare([a.directions + a.channels, *[a.width] * a.layers, 3]).to(device)
    inputs = torch.rand(rows, a.directions + a.channels, generator=generator).to(device)

    def stage_1() -> None:
        tensor_of(*material._features(uv, seen, None), rows=rows)

    def stage_2() -> None:
        tensor_of(*material.eval_columns(c, points), rows=rows)

    def chunks() -> Tensor:
        return torch.cat([bare(part) for part in inputs.split(CHUNK)])

    timed: dict[str, Callable[[], object]] = {
        "stage 1": stage_1,
        "stage 2": stage_2,
        "bare": lambda: bare(inputs),
        "bare, in chunks": chunks,
    }
    seconds: dict[str, list[float]] = {name: [] for name in timed}
    with torch.inference_mode():
        for round_ in range(rounds + 1):
            for name, work in timed.items():
                spent = _seconds(work, device)
                if round_:
                    seconds[name].append(spent)
    return Timing(rows, seconds)


def _bare(widths: list[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in zip(widths[:-1], widths[1:], strict=True):
        layers += [nn.Linear(a, b), nn.LeakyReLU(0.01)]
    return nn.Sequential(*layers[:-1], nn.ReLU()).requires_grad_(False)


def _seconds(work: Callable[[], object], device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize()
    start = time.perf_counter()
    work()
    if device != "cpu":
        torch.cuda.synchronize()
    return time.perf_counter() - start
