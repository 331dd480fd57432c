"""f of a surface at given pairs of directions, by paths: what NeuMIP's way learns from.

Walks need a micro-BSDF that samples itself. This needs one that can be evaluated too, towards the
light at every vertex, which a mirror cannot.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import columns_of, tensor_of
from harness.core.protocol.errors import InputError
from harness.microgeometry.walks.hits import Hit
from harness.microgeometry.walks.kernel import LANES, stream
from harness.microgeometry.walks.surface import WalkedSurface


def evaluate(
    surface: WalkedSurface, u: Tensor, wi: Tensor, wo: Tensor, seed: int, device: str = "cpu"
) -> Tensor:
    r"""One path a row: estimates [N, 3] of f, without cosine, at ``wi`` and ``wo`` [N, 2].

    Through the places ``u`` [N, 2] of the reference plane. With the throughput :math:`T_k` before
    the k-th interaction, the micro-BSDF :math:`f_k` and whether ``wo`` is seen from there,

    .. math:: f \approx \frac{1}{|\cos\theta_o|} \sum_k T_k\,f_k(\omega_o)\,|\cos\theta_k|\,V_k

    whose mean over u is what :meth:`WalkedSurface.walk` distributes its particles by. Paths end by
    Russian roulette, or after the surface's bound of interactions.

    Raises:
        InputError: a micro-BSDF with a mirror in it.
    """
    geometry = surface.geometry(device)
    mi = geometry.mi
    if any(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) for bsdf in geometry.bsdfs):
        raise InputError(f"{surface.name}: a mirror cannot be evaluated, only walked on")
    found = []
    for first in range(0, len(u), LANES):
        part = slice(first, first + LANES)
        rows = len(u[part])
        (x, y), *ways = (columns_of(v[part].to(device)) for v in (u, wi, wo))
        down, light = (mi.Vector3f(a, b, dr.sqrt(1 - a * a - b * b)) for a, b in ways)
        random = stream(mi, dr.arange(mi.UInt32, rows) + dr.opaque(mi.UInt32, first), seed)
        origin = geometry.first(x, y, down)
        total = _radiance(
            geometry, origin, -down, light, random, dr.opaque(mi.UInt32, surface.bound)
        )
        found.append(tensor_of(*(total / light.z), rows=rows))
    return torch.cat(found) if found else wi.new_empty(0, 3)


@dr.syntax
def _radiance(geometry, origin, direction, light, random, bound):
    """Radiance for light of unit irradiance across its beam, rgb."""
    mi = geometry.mi
    context = mi.BSDFContext()
    o, d = mi.Point3f(origin), mi.Vector3f(direction)
    n = dr.width(light)
    total, throughput = dr.zeros(mi.Color3f, n), dr.ones(mi.Color3f, n)
    alive, met = dr.full(mi.Mask, True, n), dr.zeros(mi.UInt32, n)
    while dr.hint(alive, mode="symbolic", label="path"):
        hit = geometry.hit(o, d, alive)
        alive &= hit.valid
        value = throughput * _evaluated(geometry, context, hit, light, alive)
        lit = alive & dr.any(value > 0)
        other = geometry.hit(geometry.spawn(hit, light), light, lit)
        total += dr.select(lit & ~other.valid & ~other.given_up, value, 0)
        first = random.next_float32(alive)
        second = mi.Point2f(random.next_float32(alive), random.next_float32(alive))
        taken, weight = geometry.sample(context, hit, first, second, alive)
        throughput *= dr.select(alive, weight, 0)
        kept = dr.minimum(dr.max(throughput), 1)
        alive &= random.next_float32(alive) < kept
        throughput *= dr.select(alive, dr.rcp(kept), 0)
        met += 1
        alive &= met < bound
        d = dr.select(alive, hit.si.to_world(taken), d)
        o = dr.select(alive, geometry.spawn(hit, d), o)
    return total


def _evaluated(geometry: Any, context: Any, hit: Hit, light: Any, active: Any) -> Any:
    """The micro-BSDF that holds at a hit, towards the light, with its cosine, rgb."""
    wo = hit.si.to_local(light)
    first, *others = (
        bsdf.eval(context, hit.si, wo, active) * share
        for bsdf, share in zip(geometry.bsdfs, geometry.shares, strict=True)
    )
    value = dr.select(hit.second, others[0], first) if others else first
    return dr.select(wo.z > 0, value * hit.tint, 0)
