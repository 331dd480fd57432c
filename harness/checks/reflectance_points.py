"""Where f is, found without trusting the method under test: its samples are but one way to look."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.checks import peaks
from harness.checks.evidence import Evidence
from harness.checks.quadrature import hemisphere_to_square, square_to_hemisphere
from harness.checks.subject import Case, Subject
from harness.core.protocol.disk import cos_theta

GRID = 256
"""Stratified points per side of the hemisphere that look for f where p has no samples."""
PEAK_POINTS = 1 << 14
"""Points around the places where a lobe may be narrower than the grid is fine."""


class Seen(NamedTuple):
    """Points [m, 2] of the square in proportion to f, f [m] there, and its integral."""

    points: NDArray
    density: NDArray
    scale: float


def look(found: Evidence, rng: np.random.Generator) -> Seen:
    """Samples, a stratified grid and points around peaks, resampled in proportion to f.

    The balance heuristic: f / (n_grid * 1 + n_peaks q + n p), densities per area of the square.
    """
    subject, case = found.subject, found.case
    corner = np.stack(np.meshgrid(np.arange(GRID), np.arange(GRID)), -1).reshape(-1, 2)
    grid = (corner + rng.random(corner.shape)) / GRID
    at = peaks.centres(subject.material, case)
    near = peaks.draw(at, PEAK_POINTS, rng)
    around, on = hemisphere_to_square(near)
    spread = torch.cat([square_to_hemisphere(grid)[0], near[torch.from_numpy(on)]])
    spread = spread.to(subject.device)
    points, valid = found.places
    inside = torch.from_numpy(valid).to(subject.device)
    mine, asked = found.drawn.wo.detach()[inside], found.asked.detach()[inside]
    pdf = torch.cat([subject.pdf(case.rows(len(spread)), spread).detach(), asked])
    points = np.concatenate([grid, around, points])
    wo = torch.cat([spread, mine.to(spread.dtype)])
    jacobian = (2 * math.pi * cos_theta(wo)).double().cpu().numpy()
    target = jacobian * reflectance(subject, case, wo)
    density = jacobian * pdf.double().cpu().numpy()
    others = jacobian * peaks.density(at, wo).numpy()
    share = target / (len(grid) + PEAK_POINTS * others + len(valid) * density)
    # A density of nan or below zero is found elsewhere; here it is only no place to look.
    share = np.where(np.isfinite(share) & (share > 0), share, 0.0)
    if not share.any():
        return Seen(points[:0], target[:0], 0.0)
    chosen = resampled(share, rng)
    return Seen(points[chosen], target[chosen], float(share.sum()))


def resampled(share: NDArray, rng: np.random.Generator) -> NDArray:
    """Indices in proportion to ``share``, as many as it is worth: (sum)^2 / sum of squares."""
    share = share / share.sum()
    m = max(1, int(1 / np.square(share).sum()))
    at = (np.arange(m) + rng.random()) / m
    return np.minimum(np.searchsorted(share.cumsum(), at), len(share) - 1)


def reflectance(subject: Subject, case: Case, wo: Tensor) -> NDArray:
    """f [N] per disk area, in double precision."""
    wo = wo.detach().to(subject.device)
    return subject.material.target(case.rows(len(wo)), wo).detach().double().cpu().numpy()
