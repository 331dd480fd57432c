"""Integrals of densities over the projected disk, for tests."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, inside_disk, square_to_disk
from harness.core.protocol.method import Method
from harness.stats.chisquare import ChiSquare, chi_square

BINS = 16


@functools.cache
def nodes(inner: int = 4, rim: int = 8) -> tuple[Tensor, Tensor, Tensor]:
    """Quadrature over the disk: points [M, 2], weights [M] that sum to pi, bin of each [M].

    A product rule on the square of the equal-area concentric map, of 64 intervals per axis:
    midpoints, so that histograms of up to 64 cells a side are integrated exactly, and along
    the edge midpoints in t of s = t^2, in which densities like 1 / cos(theta) are smooth.
    """
    step = 1 / 64
    t = (torch.arange(rim, dtype=torch.float64) + 0.5) / rim
    low, low_weight = step * t.square(), 2 * t * step / rim
    count = 62 * inner
    mid = step + (torch.arange(count, dtype=torch.float64) + 0.5) * step / inner
    x = torch.cat([low, mid, (1 - low).flip(0)])
    w = torch.cat([low_weight, torch.full((count,), step / inner).double(), low_weight.flip(0)])
    square = torch.cartesian_prod(x, x)
    weight = torch.pi * torch.outer(w, w).flatten()
    return square_to_disk(square).float(), weight, bins(square)


def bins(square: Tensor) -> Tensor:
    """Index [N] of the bin, of BINS x BINS, that holds points [N, 2] of the unit square."""
    cell = (square * BINS).long().clamp(0, BINS - 1)
    return cell[:, 0] * BINS + cell[:, 1]


def compare(
    method: Method, row: Tensor, n: int, generator: torch.Generator
) -> tuple[ChiSquare, float, float]:
    """Chi-square of ``n`` samples for the condition ``row`` [C] against the method's pdf.

    Also the integral of the pdf over the disk and the share of valid samples. Invalid samples
    are one more bin of the test.
    """
    wo, weight, where = nodes()
    pdf = method.pdf(row.expand(len(wo), -1), wo).double()
    mass = np.bincount(where, (pdf * weight).numpy(), BINS * BINS)
    sample = method.sample(row.expand(n, -1), torch.rand(n, 3, generator=generator)).wo
    inside = inside_disk(sample)
    count = np.bincount(bins(disk_to_square(sample[inside].double())), minlength=BINS * BINS)
    invalid = n - int(inside.sum())
    expected = np.append(mass * n, (1 - mass.sum()) * n)
    test = chi_square(np.append(count, invalid), expected)
    return test, float(mass.sum()), 1 - invalid / n
