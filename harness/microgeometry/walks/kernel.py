"""The walk: one symbolic kernel for all particles of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of

LANES = 1 << 20
"""Particles in flight at a time; bounds the memory whatever their number."""

BOUND = 256
"""Interactions after which a particle is given up, and counted."""


@dataclass
class Counts:
    """What became of particles.

    ``unfinished`` had not left after the bound (or a ray of theirs found no end); ``interactions``
    are meetings with the surface; of them ``above_one`` had a weight above one, where Russian
    roulette cannot keep the particle's weight at one and loses energy instead.
    """

    walks: int = 0
    left: int = 0
    unfinished: int = 0
    interactions: int = 0
    above_one: int = 0

    @property
    def absorbed(self) -> int:
        """Neither left nor unfinished."""
        return self.walks - self.left - self.unfinished

    def add(self, other: Counts) -> None:
        """Sum, in place."""
        for key, value in vars(other).items():
            setattr(self, key, getattr(self, key) + value)


class Exits(NamedTuple):
    """Where particles leave: directions ``wo`` [N, 2] on the disk, and ``left`` [N], whether they
    do, after ``bounces`` [N] interactions. The direction of one that does not is the origin."""

    wo: Tensor
    left: Tensor
    bounces: Tensor
    counts: Counts


def walk(
    geometry: Any,
    u: Tensor,
    wi: Tensor,
    channel: Tensor,
    seed: int,
    bound: int = BOUND,
    device: str = "cpu",
    lanes: int = LANES,
) -> Exits:
    r"""One particle a row, from ``wi`` [N, 2] through ``u`` [N, 2] of the reference plane.

    It carries the colour ``channel`` [N] (0, 1, 2) alone. With weight w of the sampled micro-BSDF
    in that channel it survives an interaction with probability w, so that its own weight is one
    throughout, and

    .. math:: P(\text{left}, \omega_o \in A) = \int_A f\,d\omega_o^\perp

    per channel, in the mean over places (PureSample, appendix C). Random numbers depend on
    ``seed`` and the row's index and not on the batch.
    """
    mi = geometry.mi
    wo, left, bounces, counts = [], [], [], Counts()
    for first in range(0, len(u), lanes):
        part = slice(first, first + lanes)
        rows = len(u[part])
        (x, y), (wi_x, wi_y) = (columns_of(v[part].to(device)) for v in (u, wi))
        (of,) = columns_of(channel[part].to(device)[:, None])
        random = stream(mi, dr.arange(mi.UInt32, rows) + dr.opaque(mi.UInt32, first), seed)
        direction = mi.Vector3f(wi_x, wi_y, dr.sqrt(1 - wi_x * wi_x - wi_y * wi_y))
        origin = geometry.first(x, y, direction)
        found = _walk(
            geometry, origin, -direction, mi.UInt32(of), random, dr.opaque(mi.UInt32, bound)
        )
        dr.eval(found)
        out, away, interactions, above, unfinished = found
        counts.add(
            Counts(
                walks=rows,
                left=int(dr.count(away)[0]),
                unfinished=int(dr.count(unfinished)[0]),
                interactions=int(dr.sum(mi.UInt64(interactions))[0]),
                above_one=int(dr.sum(mi.UInt64(above))[0]),
            )
        )
        wo.append(tensor_of(out.x, out.y, rows=rows))
        left.append(tensor_of(dr.select(away, mi.Float(1), 0), rows=rows) > 0)
        bounces.append(tensor_of(mi.Float(interactions), rows=rows).int())
    if not wo:
        none = torch.empty(0, dtype=torch.int32)
        return Exits(wi.new_empty(0, 2), none > 0, none, counts)
    return Exits(torch.cat(wo), torch.cat(left), torch.cat(bounces), counts)


def stream(mi: Any, row: Any, seed: int) -> Any:
    """A random stream of its own for each row."""
    a, b = mi.sample_tea_32(row, dr.opaque(mi.UInt32, seed & 0xFFFFFFFF))
    c, d = mi.sample_tea_32(a ^ dr.opaque(mi.UInt32, (seed >> 32) & 0xFFFFFFFF), b)
    random = mi.PCG32()
    random.seed((mi.UInt64(a) << 32) | mi.UInt64(b), (mi.UInt64(c) << 32) | mi.UInt64(d))
    return random


@dr.syntax
def _walk(geometry, origin, direction, channel, random, bound):
    """(direction of exit, whether it left, interactions, weights above one, unfinished)."""
    mi = geometry.mi
    context = mi.BSDFContext()
    # Copies, for the loop writes to them.
    o, d = mi.Point3f(origin), mi.Vector3f(direction)
    n = dr.width(channel)
    alive, left, lost = (dr.full(mi.Mask, start, n) for start in (True, False, False))
    met, above = dr.zeros(mi.UInt32, n), dr.zeros(mi.UInt32, n)
    while dr.hint(alive, mode="symbolic", label="walk"):
        hit = geometry.hit(o, d, alive)
        lost |= alive & hit.given_up
        left |= alive & ~hit.valid & ~hit.given_up & (d.z > 0) & (met > 0)
        alive &= hit.valid
        first = random.next_float32(alive)
        second = mi.Point2f(random.next_float32(alive), random.next_float32(alive))
        taken, weight = geometry.sample(context, hit, first, second, alive)
        kept = dr.select(channel == 0, weight.x, dr.select(channel == 1, weight.y, weight.z))
        met += dr.select(alive, 1, 0)
        above += dr.select(alive & (kept > 1 + 1e-5), 1, 0)
        alive &= random.next_float32(alive) < kept
        lost |= alive & (met >= bound)
        alive &= met < bound
        d = dr.select(alive, hit.si.to_world(taken), d)
        o = dr.select(alive, geometry.spawn(hit, d), o)
    inside = mi.Point2f(dr.select(left, d.x, 0), dr.select(left, d.y, 0))
    return inside, left, met, above, lost
