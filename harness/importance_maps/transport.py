r"""One-to-one optimal transport from a regular grid to as many points.

.. math:: \min_\psi \sum_i \lVert \alpha_i - \beta_{\psi(i)} \rVert^2

over permutations (eq. 5 of Bai et al. 2023, with squared distances: it is they that make the
continuous map the gradient of a convex function, whose Jacobian is symmetric and positive).

The paper starts from geomloss and refines by sliced transport. Here: sliced transport moves
the grid onto the points; bijections by random binary space partitions, merged (Genest et al.
2025, BSP-OT), round that; and exchanges between neighbours remove most of what is left. (POT's own
``ot.bsp`` gives another plan at every call, whatever its seed.) ``refine`` then solves the
transport problem on the edges that a neighbourhood offers, by the network simplex.
"""

from __future__ import annotations

import os

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse import csgraph

# POT looks for every array library there is; nothing here needs another than numpy's.
for _name in ("PYTORCH", "JAX", "CUPY", "TENSORFLOW"):
    os.environ.setdefault(f"POT_BACKEND_DISABLE_{_name}", "1")

SLICES = 30
"""Random directions, each with its perpendicular, in which the grid is sorted onto the points."""
PLANS = 16
"""Bijections by random partitions of the moved grid, and as many of the grid, that are merged."""
REACH = 4
"""Distance in the grid over which partners are exchanged."""
SWEEPS = 2
"""How often all distances are gone through; a third sweep finds little more."""
CANDIDATES = 3
"""Distance in the grid from which a refined plan may take a partner."""


def grid(resolution: int) -> NDArray[np.float64]:
    """Centres [R^2, 2] of the unit square's cells, scaled to [-1, 1]^2; x runs fastest."""
    centre = (np.arange(resolution) + 0.5) * (2 / resolution) - 1
    return np.stack(np.meshgrid(centre, centre), -1).reshape(-1, 2)


def cost(points: NDArray, plan: NDArray) -> float:
    """Mean squared distance of the grid to ``points[plan]``, both on [-1, 1]^2."""
    source = grid(round(len(points) ** 0.5))
    return float(np.square(source - points[plan]).sum(1).mean())


def transport(points: NDArray, refine: bool | None = None, seed: int = 0) -> NDArray[np.int64]:
    """A permutation [R^2]: cell i of the grid goes to ``points[plan[i]]``.

    ``refine``: by network simplex on candidate edges, about 0.7 s for 64^2 points; without,
    within one per cent of it at 128^2 in about 1 s, within two or three for fewer than 48^2. By
    default refined at 33^2 to 64^2: smaller maps are of coarse cells anyway.

    Raises:
        ValueError: the number of points is not a square.
    """
    n = len(points)
    resolution = round(n**0.5)
    if resolution**2 != n:
        raise ValueError(f"expected a square number of points, not {n}")
    points = np.ascontiguousarray(points, np.float64)
    source, rng = grid(resolution), np.random.default_rng(seed)
    moved = _sliced(source, points, rng)
    plans = [_partitioned(side, points, rng) for side in (moved, source) for _ in range(PLANS)]
    plan = plans[0]
    for other in plans[1:]:
        plan = _merged(source, points, plan, other)
    for _ in range(SWEEPS):
        plan = _exchanged(points, plan, resolution, rng)
    if refine is None:
        refine = 32 < resolution <= 64
    return _refined(source, points, plan, plans, resolution) if refine else plan


def _partitioned(source: NDArray, points: NDArray, rng: np.random.Generator) -> NDArray:
    """A bijection [n]: both sets are halved along random directions until all parts are single."""
    n = len(source)
    angles, part = rng.random((n.bit_length(), 2)) * np.pi, np.zeros(n, np.int64)
    order = [np.arange(n), np.arange(n)]
    for k in range((n - 1).bit_length()):
        # Two directions a level, taken by turns: parts beside each other are cut differently.
        angle = angles[k][part % 2]
        axis = np.stack([np.cos(angle), np.sin(angle)], 1)
        for i, side in enumerate((source, points)):
            at = (side[order[i]] * axis).sum(1)
            order[i] = order[i][np.lexsort((at, part))]
        first = np.flatnonzero(np.diff(part, prepend=-1))
        size = np.diff(first, append=n)
        rank = np.arange(n) - np.repeat(first, size)
        second = rank >= np.repeat((size + 1) // 2, size)
        part = np.cumsum(np.diff(2 * part + second, prepend=-1) > 0) - 1
    plan = np.empty(n, np.int64)
    plan[order[0]] = order[1]
    return plan


def _merged(source: NDArray, points: NDArray, one: NDArray, other: NDArray) -> NDArray:
    """The cheaper of two bijections on every set of cells that both send to the same points."""
    n = len(one)
    owner = np.empty(n, np.int64)
    owner[one] = np.arange(n)
    links = sparse.coo_matrix((np.ones(n, np.int8), (np.arange(n), owner[other])), shape=(n, n))
    count, cycle = csgraph.connected_components(links, directed=False)
    gain = np.square(source - points[one]).sum(1) - np.square(source - points[other]).sum(1)
    better = np.bincount(cycle, gain, count) > 0
    return np.where(better[cycle], other, one)


def _sliced(source: NDArray, points: NDArray, rng: np.random.Generator) -> NDArray:
    """``source`` moved onto ``points``: sorted along random directions, one after another."""
    moved = source.copy()
    for angle in rng.random(SLICES) * np.pi:
        cos, sin = np.cos(angle), np.sin(angle)
        for axis in (np.array([cos, sin]), np.array([-sin, cos])):
            at, wanted = moved @ axis, np.sort(points @ axis)
            order = np.argsort(at)
            shift = np.empty_like(at)
            shift[order] = wanted - at[order]
            moved += shift[:, None] * axis
    return moved


def _exchanged(
    points: NDArray, plan: NDArray, resolution: int, rng: np.random.Generator
) -> NDArray:
    """``plan`` after exchanging partners wherever two cells within ``REACH`` gain by it.

    For cells d apart that is where :math:`\\langle d, t_j - t_i \\rangle < 0`.
    """
    n = resolution
    to, at = plan.reshape(n, n).copy(), points[plan].reshape(n, n, 2).copy()
    reach = min(REACH, n - 1)
    offsets = [(a, b) for a in range(reach + 1) for b in range(-reach, reach + 1) if a > 0 or b > 0]
    for k in rng.permutation(len(offsets)):
        a, b = offsets[k]
        apart = np.array([b, a], float)
        rows, columns = np.arange(n - a), np.arange(max(0, -b), n - max(0, b))
        for parity in (0, 1):
            # Of each chain of cells the offset apart, every other pair: no cell is in two.
            i = rows[(rows // a) % 2 == parity] if a else rows
            j = columns if a else columns[(columns // b) % 2 == parity]
            here, there = np.ix_(i, j), np.ix_(i + a, j + b)
            gain = (at[there] - at[here]) @ apart < 0
            for values in (to, at):
                one, other = values[here], values[there]
                swap = gain if values.ndim == 2 else gain[..., None]
                values[here], values[there] = (
                    np.where(swap, other, one),
                    np.where(swap, one, other),
                )
    return to.ravel()


def _refined(
    source: NDArray, points: NDArray, plan: NDArray, plans: list[NDArray], resolution: int
) -> NDArray[np.int64]:
    """The best plan that uses partners of near cells, or of the other ``plans``."""
    import ot

    n = resolution * resolution
    start, end = [np.tile(np.arange(n), len(plans))], [np.concatenate(plans)]
    near, to = np.arange(n).reshape(resolution, resolution), plan.reshape(resolution, resolution)
    reach = min(CANDIDATES, resolution - 1)
    for a in range(-reach, reach + 1):
        for b in range(-reach, reach + 1):
            i = np.arange(max(0, -a), resolution - max(0, a))
            j = np.arange(max(0, -b), resolution - max(0, b))
            start.append(near[np.ix_(i, j)].ravel())
            end.append(to[np.ix_(i + a, j + b)].ravel())
    edges = np.unique(np.concatenate(start) * n + np.concatenate(end))
    i, j = np.divmod(edges, n)
    # A stored zero would be no edge at all.
    length = np.square(source[i] - points[j]).sum(1) + 1e-12
    even = np.full(n, 1 / n)
    flow = sparse.coo_matrix(
        ot.emd(even, even, sparse.coo_matrix((length, (i, j)), shape=(n, n)), numItermax=10**8)
    )
    found = np.empty(n, np.int64)
    found[flow.row] = flow.col
    if len(np.unique(flow.row)) != n or len(np.unique(found)) != n:
        raise RuntimeError("the network simplex gave no bijection")
    return found
