r"""The mass of a density on adaptive cells of the hemisphere, by stratified Monte Carlo.

The unit square maps to the hemisphere so that equal areas are equal solid angles:
concentrically to a disk of radius r', and from there to the projected disk by
:math:`r = r'\sqrt{2 - r'^2}`, which makes :math:`\cos\theta = 1 - r'^2`. A density p per
disk area then has the mass

.. math:: \int p\,dA = \int_{[0,1]^2} 2\pi\,p\,\cos\theta\;ds ,

and the factor cos tames densities that grow like 1/cos towards the rim (all those which
are finite per solid angle there). Every cell is cut in four, with two random points in each
quarter: unbiased, with an unbiased variance, for smooth densities and stepped ones alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.core.protocol.disk import cos_theta, disk_to_square, square_to_disk
from harness.stats.cells import DEPTH, Cells, morton

POINTS = 8
"""Points per cell: two in each quarter."""
TARGET = 2e-4
"""Standard deviation of the whole integral at which refinement stops."""
UNCERTAIN = 0.2
"""Variance of a cell's expected count, relative to the count's own, at which it is split."""
SLIVER = 4.0
"""Mass of a cell as full as its densest hint, over its estimated mass, at which it is split."""
ROUNDS = 16
PASSES = 2


def square_to_hemisphere(square: NDArray) -> tuple[Tensor, NDArray]:
    """Points of [0,1]^2 as ``wo`` [n, 2] in single precision, and cos(theta) [n] in double."""
    flat = square_to_disk(torch.from_numpy(square))
    s = flat.square().sum(-1, keepdim=True)
    return (flat * (2 - s).sqrt()).float(), (1 - s[:, 0]).numpy()


def hemisphere_to_square(wo: Tensor) -> tuple[NDArray, NDArray]:
    """Inverse for the valid ones of ``wo`` [N, 2]: points [n, 2]; and which are, bool [N]."""
    wo = wo.detach().to("cpu", torch.float64)
    radius = wo.square().sum(-1)
    valid = radius < 1
    inside = wo[valid]
    cos = (1 - radius[valid]).sqrt()
    return disk_to_square(inside / (1 + cos).sqrt()[:, None]).numpy(), valid.numpy()


def per_square(pdf: Tensor, wo: Tensor) -> NDArray:
    """Density [N] per area of the square, from that per disk area at ``wo`` [N, 2]."""
    pdf, wo = pdf.detach().to("cpu", torch.float64), wo.detach().to("cpu", torch.float64)
    return (2 * math.pi * pdf * cos_theta(wo)).numpy()


class Masses:
    """Mass of a density in each of ``cells``, and the variance of that estimate."""

    def __init__(self, cells: Cells, mass: NDArray, variance: NDArray):
        self.cells, self.mass, self.variance = cells, mass, variance

    @property
    def total(self) -> float:
        """Integral over the disk."""
        return float(self.mass.sum())

    @property
    def error(self) -> float:
        """Standard deviation of the integral."""
        return math.sqrt(self.variance.sum())

    def gathered(self, coarse: Cells) -> Masses:
        """The same in the cells of which these are a refinement."""
        owner = coarse.owner(self.cells)
        n = len(coarse)
        return Masses(
            coarse,
            np.bincount(owner, self.mass, minlength=n),
            np.bincount(owner, self.variance, minlength=n),
        )


@dataclass(frozen=True)
class Hints:
    """Places where mass may be: points [m, 2] of the square, and the density [m] there.

    Samples of the method under test. They decide only where to look more closely, which makes
    the integral better whatever they are; a wrong sampler cannot talk itself right.
    """

    points: NDArray
    density: NDArray

    def count(self, cells: Cells) -> NDArray:
        """Number of hints in each of ``cells``, which cover the square."""
        return np.diff(self._begin(cells), append=len(self.points))

    def highest(self, cells: Cells) -> NDArray:
        """Largest density of a hint in each of ``cells``, which cover the square; 0 without one."""
        found, full = np.zeros(len(cells)), self.count(cells) > 0
        if full.any():
            # Cells without hints end where they begin, so the next full one ends a segment.
            found[full] = np.maximum.reduceat(self._sorted[1], self._begin(cells)[full])
        return found

    @cached_property
    def _sorted(self) -> tuple[NDArray, NDArray]:
        """Codes and densities in the order of the codes: sorted once, looked up in every round."""
        codes = morton(self.points)
        order = np.argsort(codes)
        return codes[order], self.density[order]

    def _begin(self, cells: Cells) -> NDArray:
        """How many hints come before each cell."""
        return np.searchsorted(self._sorted[0], cells.start)


def integrate(
    density: Callable[[Tensor], Tensor],
    hints: Hints,
    rng: np.random.Generator,
    cells: Cells,
    most: int = 60_000,
) -> Masses:
    """Integrate ``density`` (``wo`` [n, 2] -> [n], per disk area) over the disk.

    Starts from ``cells`` and splits the doubtful ones until there are none, or until
    there are ``most`` of all; the error left is in the result.

    The result is evaluated afresh on the final cells. The estimates that steered the refinement
    are biased by it: cells that came out too large were split, those too small were not.
    Looking ``PASSES`` times afresh before that finds edges that the points missed at first.
    """
    masses = evaluate(density, cells, rng)
    for _ in range(PASSES):
        cells = _refine(density, hints, rng, masses, most)
        masses = evaluate(density, cells, rng)
    return masses


def _refine(
    density: Callable[[Tensor], Tensor],
    hints: Hints,
    rng: np.random.Generator,
    masses: Masses,
    most: int,
) -> Cells:
    """The cells of ``masses``, with doubtful ones split until there are none."""
    for _ in range(ROUNDS):
        doubt = _doubt(masses, hints)
        chosen = doubt > 0
        splits = (most - len(masses.cells)) // 3
        if splits < 1 or not chosen.any():
            break
        if chosen.sum() > splits:
            chosen = np.zeros_like(chosen)
            chosen[np.argsort(-doubt)[:splits]] = True
        old = masses.cells
        parents = Cells(old.start[chosen], old.level[chosen])
        children = parents.split(np.ones(len(parents), bool))
        new = evaluate(density, children, rng)
        start = np.concatenate([old.start[~chosen], children.start])
        order = np.argsort(start)
        masses = Masses(
            Cells(start[order], np.concatenate([old.level[~chosen], children.level])[order]),
            np.concatenate([masses.mass[~chosen], new.mass])[order],
            np.concatenate([masses.variance[~chosen], new.variance])[order],
        )
    return masses.cells


def _doubt(masses: Masses, hints: Hints) -> NDArray:
    """How far each cell's mass may be off, in counts of hints; 0 where it is good enough.

    A cell is doubtful where its share of the whole variance is too large; where it is
    uncertain beside the Poisson noise of its count (the edge of a step runs through it); where
    mass and count contradict each other (a lobe between the points); and where a hint's
    density is so far above the cell's average that a sliver of it may have gone unseen.
    """
    n = len(hints.points)
    expected = n * masses.mass
    count = hints.count(masses.cells)
    noise = n * np.sqrt(masses.variance)
    order = np.argsort(-masses.variance)
    left = masses.variance.sum() - np.cumsum(masses.variance[order])
    chosen = np.zeros(len(masses.cells), bool)
    if masses.error > TARGET:
        chosen[order[: int((left > TARGET**2 / 4).sum()) + 1]] = True
    chosen |= noise**2 > UNCERTAIN * np.maximum(expected, 1)
    # Three Poisson deviations, and two for counts too small for that.
    chosen |= np.abs(count - expected) > 3 * np.sqrt(np.abs(expected)) + 2
    full = n * hints.highest(masses.cells) * masses.cells.side**2
    chosen |= full > SLIVER * (expected + 1)
    off = np.maximum(noise, np.abs(count - expected)) + np.minimum(full, count)
    return np.where(chosen & (masses.cells.level < DEPTH), off, 0.0)


def evaluate(density: Callable[[Tensor], Tensor], cells: Cells, rng: np.random.Generator) -> Masses:
    """Masses of ``density`` (as in :func:`integrate`) in the given cells, by fresh points."""
    n = len(cells)
    quarters = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])[None, :, None]
    place = (quarters + rng.random((n, 4, 2, 2))) / 2
    square = cells.corner[:, None, None] + place * cells.side[:, None, None, None]
    wo, cos = square_to_hemisphere(square.reshape(-1, 2))
    value = density(wo).detach().to("cpu", torch.float64).numpy() * cos * (2 * math.pi)
    value = value.reshape(n, 4, 2)
    area = cells.side**2 / 4
    mass = value.mean(-1).sum(-1) * area
    variance = (np.square(value[..., 0] - value[..., 1]) / 4).sum(-1) * area**2
    return Masses(cells, mass, variance)
