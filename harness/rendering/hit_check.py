"""Is the material that a method is fitted to the one that the scene shows? Asked in every scene.

A method is fitted at conditions: rows of numbers that stand for a place and a direction. A
renderer evaluates the material's BSDF at points of shapes. Where the two differ, the method was
fitted to another surface, and nothing in an unbiased image would tell.

Import this module after ``variant.use``: a Mitsuba class belongs to a variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from harness.core.protocol.errors import Unsupported

RAYS = 1 << 14
"""Camera rays; every hit sends one more ray on."""
APART = 0.02
"""Relative difference of two values that count as different, beyond what rounding explains."""
SHARE = 2e-3
"""Of lit points that may be so: a seam of a texture, a normal that turns to the other side."""
_NUDGE = 2e-6


def check(scene: mi.Scene, placed: Any) -> None:
    """Compare ``placed.nested`` at true hits of ``scene`` with the material at their conditions.

    ``placed`` is a :class:`~harness.rendering.plugin.SampledBSDF`. Nothing to compare where the
    material is no Mitsuba BSDF: it is then evaluated at conditions alone.

    Raises:
        Unsupported: they differ, with how many points do.
    """
    if placed.nested is None:
        return
    apart = lit = 0
    for si, active in _hits(scene, placed):
        dr.eval(si, active)  # a kernel of its own, which serves all materials
        a, b = _compared(placed, si, active)
        apart, lit = apart + a, lit + b
    if apart <= max(2, SHARE * lit):
        return
    raise Unsupported(
        f"material '{placed.material.name}': at {apart} of {lit} points of this scene its BSDF is"
        " not what it is at the conditions that stand for them: it reads more of a point than they"
        " carry (such as its position, its shape or the side it is seen from), so a method would"
        " be fitted to another surface"
    )


def is_seen(scene: mi.Scene, placed: Any) -> bool:
    """Whether any camera ray meets ``placed`` from a side that reflects."""
    si, active = next(_hits(scene, placed))
    return bool(np.any(np.array(active & (placed.facing(si)[0].wi.z > 0))))


def _hits(scene: mi.Scene, placed: Any) -> Any:
    """Points of the BSDF that the camera sees, and points that are seen from any of those."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(7, RAYS)
    ray, _ = scene.sensors()[0].sample_ray(
        0.0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    )
    pointer = mi.BSDFPtr(placed)
    dr.make_opaque(pointer)  # so that the kernels serve all methods of a material
    si = scene.ray_intersect(ray)
    yield si, si.is_valid() & (si.bsdf() == pointer)
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    local.z *= dr.sign(si.wi.z)
    after = scene.ray_intersect(si.spawn_ray(si.to_world(local)), si.is_valid())
    yield after, after.is_valid() & (after.bsdf() == pointer)


def _compared(placed: Any, si: Any, active: Any) -> tuple[int, int]:
    """``(points that differ, points where either value is not zero)``."""
    material, ctx = placed.material, mi.BSDFContext()
    facing, turned = placed.facing(si)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(8, RAYS)
    drawn, _ = placed.nested.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
    around = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    around.z *= dr.sign(si.wi.z)
    # Half by the BSDF itself, so that narrow lobes are met.
    own = (sampler.next_1d() < 0.5) & (drawn.pdf > 0)
    wo = dr.select(own, drawn.wo, around)
    truth = _luminance(placed.nested.eval(ctx, si, wo, active))
    wo = turned(wo)
    reflects = active & (facing.wi.z > 0) & (wo.z > 0)
    c = material.condition_columns(facing)
    nudged = [*c[:-2], c[-2] * (1 - _NUDGE), c[-1] * (1 - _NUDGE)]
    scale = dr.select(reflects, wo.z, 0)
    dr.eval(truth, wo, scale, c, nudged)  # at once: the numbers below are then no more kernels
    truth, there, x, y, scale = (
        np.broadcast_to(np.array(v), RAYS)
        for v in (truth, active, wo.x, wo.y, scale)
    )
    # Both sets of conditions in one kernel, of half the size.
    rows = [mi.Float(np.concatenate([np.broadcast_to(np.array(v), RAYS) for v in pair]))
            for pair in zip(c, nudged, strict=True)]  # fmt: skip
    ends = [mi.Float(np.tile(v, 2)) for v in (x, y)]
    value = np.array(_luminance(material.eval_columns(rows, ends))).reshape(2, RAYS) * scale
    truth, ours, near = (v[there].astype(np.float64) for v in (truth, *value))
    most = np.maximum(np.abs(truth), np.abs(ours))
    apart = np.abs(truth - ours) > APART * most + 8 * np.abs(near - ours)
    # What is not a number on one side alone differs, too.
    apart |= np.isfinite(truth) != np.isfinite(ours)
    return int(apart.sum()), int((most > 0).sum())


def _luminance(value: Any) -> Any:
    return mi.luminance(mi.Color3f(value))
