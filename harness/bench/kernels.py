"""``python -m harness.bench.kernels``: networks over columns beside a matrix product.

One line a network, or a flow of ten steps with its density, three passes a step: GFLOP/s
(multiplications and additions of the layers) of the compiled kernels,
of Dr.Jit's cooperative vectors and of PyTorch on rows in chunks of 16,384, and in brackets their
share of a square matrix product's. One thread; the clock of the processor, which other work on the
machine lengthens less than that of the wall; shares are medians over interleaved rounds.
"""

from __future__ import annotations

import argparse
from itertools import pairwise

import drjit as dr
import numpy as np
import torch

from harness.bench.interleaved import Work, interleaved
from harness.bench.ratios import without_kernels
from harness.core.columns.bridge import columns_of
from harness.core.compiled import library
from harness.nets import discrete_flow_columns
from harness.nets.discrete_flow import DiscreteFlow
from harness.nets.encoding import Encoded
from harness.nets.mlp import MLP
from harness.nets.velocity import Velocity

NETWORKS = {
    "improved baseline": ([30, 32, 32, 32, 5], "relu"),
    "two-lobe": ([30, 32, 11], "relu"),
    "spline coupling": ([39, 32, 32, 59], "leaky_relu"),
    "histogram": ([10, 32, 32, 32, 1024], "relu"),
    "width 64": ([32, 64, 64, 64, 64], "leaky_relu"),
    "velocity, width 64": ([32, 64, 64, 64, 2], "silu"),
}
FLOWS = {
    "flow, as published": (64, 5, "silu"),
    "flow, ReLU": (64, 5, "relu"),
    "flow, small": (32, 3, "silu"),
}
STEPS, ENCODED = 10, 30
ROWS, CHUNK, SIDE = 1 << 15, 1 << 14, 768


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=25)
    rounds = parser.parse_args().rounds
    torch.set_num_threads(1)
    dr.set_thread_count(1)
    a, b = torch.randn(SIDE, SIDE), torch.randn(SIDE, SIDE)
    print(f"compiled kernels: {library.name()} {library.why_not()}")
    print(f"{'':20}{'':24}{'compiled':>16}{'Dr.Jit':>16}{'PyTorch':>16}{'product':>10}")
    cases = {}
    for name, (widths, activation) in NETWORKS.items():
        # The whole histogram's outputs are 128 MB: fewer rows, as its batches have.
        rows = ROWS // 8 if widths[-1] > 512 else ROWS
        flops = 2 * sum(m * n for m, n in pairwise(widths)) * rows
        cases[name] = "-".join(map(str, widths)), flops, _works(widths, activation, rows)
    for name, (width, layers, activation) in FLOWS.items():
        sizes = [ENCODED + 3, *[width] * layers, 2]
        # The condition's part of the first layer is computed once, for one pass.
        passes = 2 * (3 * width + sum(m * n for m, n in pairwise(sizes[1:])))
        flops = (3 * STEPS * passes + 2 * ENCODED * width) * CHUNK
        cases[name] = "-".join(map(str, sizes)), flops, _flow_works(width, layers, activation)
    for name, (sizes, flops, works) in cases.items():
        seconds = interleaved(works | {"product": lambda: a @ b}, rounds)
        product = 2 * SIDE**3 / seconds["product"]
        line = f"{name:20}{sizes:24}"
        for kind in ("compiled", "Dr.Jit", "PyTorch"):
            if kind in seconds:
                rate = flops / seconds[kind]
                line += f"{np.median(rate) / 1e9:8.1f} ({np.median(rate / product):.2f})"
            else:
                line += f"{'-':>15}"
        print(f"{line}{np.median(product) / 1e9:10.1f}", flush=True)


def _works(widths: list[int], activation: str, rows: int) -> dict[str, Work]:
    net = MLP(widths, activation).eval()
    x = torch.randn(rows, widths[0])
    columns = columns_of(x)
    found: dict[str, Work] = {}
    made = library.found()
    if not isinstance(made, str):
        packed, seen = net.compiled(made), Encoded.plain(columns)
        found["compiled"] = lambda: packed(seen)

    def cooperative() -> None:
        with without_kernels():
            dr.eval(net.columns(columns))
            dr.sync_thread()

    def in_torch() -> None:
        with torch.inference_mode():
            for chunk in x.split(CHUNK):
                net(chunk)

    return found | {"Dr.Jit": cooperative, "PyTorch": in_torch}


def _flow_works(width: int, layers: int, activation: str) -> dict[str, Work]:
    """The steps of a flow with their determinants."""
    net = Velocity(ENCODED, width, layers, activation).requires_grad_(False)
    torch.nn.init.normal_(net.layers[-1].weight, std=0.1)
    flow = DiscreteFlow(net, STEPS)
    encoded, x = torch.randn(CHUNK, ENCODED), torch.randn(CHUNK, 2)
    conditions, at = Encoded.plain(columns_of(encoded)), columns_of(x)

    def run() -> None:
        moved = discrete_flow_columns.forward(flow, at, net.shared_columns(conditions))
        dr.eval(moved.x, moved.det)
        dr.sync_thread()

    def in_dr_jit() -> None:
        with without_kernels():
            run()

    def in_torch() -> None:
        with torch.inference_mode():
            flow.forward(x[:, None], net.shared(encoded))

    found = {} if isinstance(library.found(), str) else {"compiled": run}
    return found | {"Dr.Jit": in_dr_jit, "PyTorch": in_torch}


if __name__ == "__main__":
    main()
