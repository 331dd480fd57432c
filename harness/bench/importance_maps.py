"""``python -m harness.bench.importance_maps``: what optimal-transport maps cost and are worth.

One line a slice, one of each family's lobes: CPU seconds of a map of 32^2, 64^2 and 128^2 points in
one process; transport cost of the 64^2 plan over the exact optimum (POT's dense network simplex,
seconds a slice), and chi-square per degree of freedom of its points against the slice (1 for
independent samples, 0 for perfectly even ones). Clocks of the processor, which other work on
the machine lengthens less than clocks of the wall.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

from harness.importance_maps.maps import equal_points, make_map
from harness.importance_maps.quality import coarse, histogram
from harness.importance_maps.slices import Slice, slices_of
from harness.importance_maps.transport import cost, grid, transport
from harness.materials import registry
from harness.report.tables.importance_maps import LOBES
from harness.stats.chisquare import chi_square

RESOLUTIONS = (32, 64, 128)
FAMILIES = ("ggx-conductor", "layered", "disney")
_TRIED, _BINS = 64, 16


def slice_pairs(family: str) -> dict[str, tuple[Slice, Slice]]:
    """The first slice of each kind of lobe, of 64^2 and of 128^2 cells."""
    material = registry.make(family)
    condition = material.conditions(_TRIED, torch.Generator().manual_seed(0), "cpu")
    found: dict[str, tuple[Slice, Slice]] = {}
    for k in range(_TRIED):
        row = condition[k : k + 1]
        one = Slice(slices_of(material, row, 64, 1)[0].double().numpy())
        name = next(name for name, low, high in LOBES if low <= one.spread < high)
        if name not in found:
            fine = Slice(slices_of(material, row, 128, 1)[0].double().numpy())
            found[name] = one, fine
        if len(found) == len(LOBES):
            break
    return {name: found[name] for name, *_ in LOBES if name in found}


def measure(pair: tuple[Slice, Slice], exact: bool) -> str:
    """The line of one slice, without its name."""
    parts = []
    for n in RESOLUTIONS:
        start = time.process_time()
        made = make_map(pair[n > 64], n)
        parts.append(f"{time.process_time() - start:6.2f}")
        if n == 64:
            wo = made.wo.reshape(-1, 2)
    points = equal_points(pair[0], 64 * 64)
    over = cost(points, transport(points)) / best(points) - 1 if exact else float("nan")
    n = len(wo)
    test = chi_square(histogram(wo, _BINS) * n, coarse(pair[0].mass, _BINS) * n)
    return "  ".join([*parts, f"{over:9.4%}", f"{test.statistic / test.dof:10.3f}"])


def best(points: np.ndarray) -> float:
    """The least mean squared distance that any plan has."""
    import ot

    source = grid(round(len(points) ** 0.5))
    even = np.full(len(points), 1 / len(points))
    distance = ot.dist(source, points)
    return float(ot.emd2(even, even, distance, numItermax=10**8))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-exact", action="store_true", help="leave the exact optimum out")
    exact = not parser.parse_args().no_exact
    print(f"{'':24}  32^2 s  64^2 s 128^2 s  over exact  chi2/dof")
    for family in FAMILIES:
        for lobe, pair in slice_pairs(family).items():
            print(f"{f'{family}, {lobe}':24}{measure(pair, exact)}", flush=True)


if __name__ == "__main__":
    main()
