"""The tail of a density: chi-square pools rare cells, and there a floor or a clamp can hide.

Cells, sorted by their density per disk area, are joined from the lowest on until they hold an
eighth of all mass, and less in steps of the root of two. How many samples fall into each such
union is binomial. A density floored at 1e-4 claims up to 3e-4 of the mass for places it never
samples: forty of 2^17 samples, none of which comes.

Counted are only samples where the density is at most a few times what a cell seemed to hold, and
so is the mass. A ridge narrower than the distance of the points, which no estimate of the mass
sees and samples find, is no part of the tail, however low the rest of its cell; it is left
to chi-square, whose cells follow the samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.checks.evidence import SAMPLES, evidence
from harness.checks.finding import Finding, rounded
from harness.checks.quadrature import (
    Masses,
    evaluate,
    hemisphere_to_square,
    per_square,
    square_to_hemisphere,
)
from harness.checks.subject import Case, Subject
from harness.stats.cells import Cells
from harness.stats.chisquare import sidak
from harness.stats.distributions import binomial_cdf, binomial_sf, normal_isf

TESTS = 1
"""Statistical tests per case; the unions share its level among them."""

FEWEST = 16
"""Least expected count of a union: below, not even an empty one would be significant."""
LARGEST = 1 / 8
"""Mass of the largest union; what is more frequent, chi-square sees."""
LEVEL, FULL = 6, 32
"""Halvings of the coarsest cells, and pilot samples at which one is split."""
FRESH = 4
"""Evaluations of the masses, apart from the one that sorts: the lowest of noisy numbers are
too low."""
CEILING = 4.0
"""Density, over a cell's average by the points that sorted it, up to which it counts as low."""
ROUNDING = 5e-4
"""Relative: what single precision may cost a mass."""


def check_tail(subject: Subject, case: Case, alpha: float) -> Finding:
    """Property ``tail``: samples are as rare as the density says where it says so.

    ``alpha`` is the level of all unions together; the number is the least p-value.
    """
    found = evidence(subject, case)
    rng = np.random.default_rng(int(torch.randint(1 << 62, (), generator=subject.generator)))

    def density(wo: Tensor) -> Tensor:
        return subject.pdf(case.rows(len(wo)), wo.to(subject.device))

    # Cells by the pilot, sorted by points of their own: where the samples themselves had a hand
    # in it, cells that happen to hold few would be large, and the lowest would hold too few.
    pilot, _ = hemisphere_to_square(found.pilot.wo)
    cells = Cells.uniform(LEVEL).refined(pilot, FULL)
    rough = evaluate(density, cells, rng).mass
    order = np.argsort(rough / _disk_area(cells), kind="stable")
    order = order[: np.searchsorted(rough[order].cumsum(), LARGEST, side="right")]
    low = Cells(cells.start[order], cells.level[order])
    ceiling = CEILING * rough / cells.side**2
    fresh = [evaluate(_cut(density, ceiling[order]), low, rng) for _ in range(FRESH)]
    mass = np.mean([m.mass for m in fresh], 0)
    variance = np.sum([m.variance for m in fresh], 0) / FRESH**2
    points, valid = found.places
    cell = cells.find(points)
    counted = per_square(found.asked, found.drawn.wo)[valid] <= ceiling[cell]
    count = np.bincount(cell[counted], minlength=len(cells))[order]
    below = rough[order].cumsum()
    return tail(case, below, Masses(low, mass, variance), count, SAMPLES, alpha)


def tail(
    case: Case, below: NDArray, masses: Masses, count: NDArray, n: int, alpha: float
) -> Finding:
    """The test itself: ``count`` [cells] of ``n`` samples against ``masses``, lowest first.

    ``below`` [cells] is about the mass up to and with each cell. It ends the unions, and like
    the order of the cells it depends neither on the samples nor on ``masses``.
    """
    name = "tail"
    mass, variance = masses.mass, masses.variance
    if not np.isfinite(mass).all():
        return Finding(name, case.name, "fail", "not tested: the density is not finite")
    sizes = LARGEST * 0.5 ** np.arange(0, math.log2(n * LARGEST / FEWEST), 0.5)
    level = sidak(alpha, len(sizes))
    worst: tuple[float, int, float, float] = (1.0, 0, 0.0, 0.0)
    for size in sizes:
        union = slice(0, int(np.searchsorted(below, size, side="right")))
        if union.stop == 0:
            break
        observed = int(count[union].sum())
        expected, error = float(mass[union].sum()), math.sqrt(variance[union].sum())
        p = binomial(observed, n, expected, error, level)
        if p <= worst[0]:
            worst = p, union.stop, observed, n * expected
    p, cells, observed, expected = worst
    ok = p >= level
    text = f"{observed} samples where {expected:.1f} are due, in the lowest {cells} cells"
    text += f", p = {p:.2g}" + ("" if ok else f" (level {level:.1g})")
    if ok:
        return Finding(name, case.name, "pass", text, number=p, unit="p-value")
    # The cell whose own surplus or lack is largest.
    cell = int(np.abs(count[:cells] - n * mass[:cells]).argmax())
    centre = masses.cells.corner[cell : cell + 1] + masses.cells.side[cell] / 2
    at = {
        "condition": rounded(case.row),
        "wo": rounded(square_to_hemisphere(centre)[0][0]),
        "got": f"{observed} samples",
        "expected": f"{expected:.1f}",
    }
    return Finding(name, case.name, "fail", text, at, number=p, unit="p-value")


def binomial(observed: int, n: int, mass: float, error: float, level: float) -> float:
    """Two-sided p-value of ``observed`` of ``n`` for a probability of ``mass`` +- ``error``.

    The mass may be anything within its own interval of a tenth of ``level``; what is
    left, nine tenths, are the counts'.
    """
    slack = normal_isf(level / 20) * error + ROUNDING * mass
    low, high = np.clip([mass - slack, mass + slack], 0, 1)
    # Too few against the least mass there may be, too many against the largest.
    few, many = binomial_cdf(observed, n, low), binomial_sf(observed - 1, n, high)
    return float(min(1.0, 2 * min(few, many) / 0.9))


def _cut(density: Callable[[Tensor], Tensor], ceiling: NDArray) -> Callable[[Tensor], Tensor]:
    """``density``, and 0 where it is above the ``ceiling`` [cells], per area of the square.

    For points in the order of :func:`evaluate`; what is no number stays none.
    """

    def cut(wo: Tensor) -> Tensor:
        pdf = density(wo)
        high = per_square(pdf, wo) > np.repeat(ceiling, len(wo) // len(ceiling))
        return torch.where(torch.from_numpy(high).to(pdf.device), 0, pdf)

    return cut


def _disk_area(cells: Cells) -> NDArray:
    """Area [n] on the projected disk, by the cosine at the centre."""
    _, cos = square_to_hemisphere(cells.corner + cells.side[:, None] / 2)
    return cells.side**2 * 2 * math.pi * cos
