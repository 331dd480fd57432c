"""``python -m harness.bench.families``: walks a second, time and noise of slices.

One line a case: million walks a second of the sampler (:meth:`WalkFamily.walk_columns`), of the
connections in :meth:`Family.eval` (with how many evaluations a second that makes), and for a
slice of 128 x 128 its seconds, the noise of one cell (root mean square difference of two
seeds, over the root of two and the mean) and of the whole slice's energy. Medians of ``--rounds``.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import torch

from harness.core.columns.bridge import columns_of
from harness.core.protocol.disk import luminance
from harness.materials import registry
from harness.materials.families.walks import WalkFamily

RESOLUTION = 128
WALKS, EVALUATIONS = 1 << 21, 1 << 16
WI = (0.5, -0.4)
CASES: dict[str, tuple[str, dict[str, float]]] = {
    "disney, roughness 0.3": ("disney", {"metallic": 0.5, "roughness": 0.3}),
    "conductor, alpha 0.1": ("ggx-conductor", {"alpha_x": 0.1, "alpha_y": 0.1}),
    "conductor, alpha 0.5": ("ggx-conductor", {"alpha_x": 0.5, "alpha_y": 0.5}),
    "conductor, alpha 1": ("ggx-conductor", {"alpha_x": 1.0, "alpha_y": 1.0}),
    "layered, no medium": ("layered", {"alpha": 0.2, "sigma_t": 0.0}),
    "layered, depth 1": ("layered", {"alpha": 0.2, "sigma_t": 1.0}),
    "layered, depth 5": ("layered", {"alpha": 0.2, "sigma_t": 5.0}),
}


def median_seconds(work: Callable[[], Any], rounds: int) -> float:
    """Median time of ``work()``, after one that compiles."""
    seconds = []
    for _ in range(rounds + 1):
        dr.sync_thread()
        start = time.perf_counter()
        dr.eval(work())
        dr.sync_thread()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def measure(family: str, fix: dict[str, float], rounds: int) -> str:
    """The line of one case, without its name."""
    rest = {"r0_r": 0.95, "r0_g": 0.6, "r0_b": 0.4} if family == "ggx-conductor" else {}
    if family == "layered":
        rest = {"eta": 1.5, "albedo_r": 0.95, "albedo_g": 0.7, "albedo_b": 0.2}
    fix = {**rest, **fix}
    material = registry.make({"name": family, "type": "family", "family": family, "fix": fix})
    generator, parts = torch.Generator().manual_seed(0), []
    row = torch.tensor([WI])
    if isinstance(material, WalkFamily):
        c = columns_of(row.expand(WALKS, -1).contiguous())
        u = columns_of(torch.rand(WALKS, 3, generator=generator))
        walked = WALKS / median_seconds(lambda: material.walk_columns(c, u), rounds)
        c = columns_of(row.expand(EVALUATIONS, -1).contiguous())
        wo = columns_of(1.2 * torch.rand(EVALUATIONS, 2, generator=generator) - 0.6)
        evaluated = EVALUATIONS / median_seconds(lambda: material.eval_columns(c, wo), rounds)
        parts = [f"{walked / 1e6:6.1f}", f"{evaluated * material.walks / 1e6:6.1f}"]
        parts += [f"{evaluated / 1e6:6.2f}"]
    else:
        parts = ["     -", "     -", "     -"]
    seconds = median_seconds(lambda: material.slices(row, RESOLUTION, 1), rounds)
    a, b = (luminance(material.slices(row, RESOLUTION, seed)[0]) for seed in (1, 2))
    lit = (a + b) > 0
    cell = ((a - b).square()[lit].mean().sqrt() / 2**0.5 / ((a + b)[lit].mean() / 2)).item()
    relative = ((a - b) / (a + b) * 2**0.5)[lit].abs().median().item() / 0.6745
    whole = (2 * (a.sum() - b.sum()) / (a.sum() + b.sum())).abs().item() / 2**0.5
    parts += [f"{seconds:6.2f}", f"{cell:7.2%}", f"{relative:7.2%}", f"{whole:7.3%}"]
    return "  ".join(parts)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    heads = ("walk M/s", "eval M/s", "eval M", "slice s", "rms cell", "typical", "energy")
    print(f"{'':24}" + "  ".join(heads))
    for name, (family, fix) in CASES.items():
        print(f"{name:24}{measure(family, fix, rounds)}", flush=True)


if __name__ == "__main__":
    main()
