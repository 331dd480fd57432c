"""Rays of walks against a displaced tile: the mesh of :mod:`harness.microgeometry.tracing`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from harness.microgeometry.tile import Tile
from harness.microgeometry.tracing import Tracer
from harness.microgeometry.walks.hits import Hit, sampled
from harness.microgeometry.walks.micro import MicroBSDF


class Heightfield:
    """A height field for walks; lengths in widths of the tile.

    The tracer is asked for hits alone, which is why the micro-BSDF may be a mirror, whose light a
    path tracer could not find.
    """

    def __init__(self, tile: Tile, micro: MicroBSDF, device: str):
        self.tracer = Tracer(replace(tile, bsdf={"type": "diffuse"}), device)
        self.mi = self.tracer.mi
        self.bsdfs = [micro.load(self.mi)]
        self.shares = [self.mi.Color3f(*micro.reflectance)]

    def first(self, u: Any, v: Any, wi: Any) -> Any:
        """Where a ray against ``wi`` through (u, v) of the reference plane comes in from above."""
        return self.tracer.start(u, v, wi)

    def hit(self, origin: Any, direction: Any, active: Any) -> Hit:
        """The first thing that a ray meets."""
        mi = self.mi
        si = self.tracer.intersect(mi.Ray3f(origin, direction), active)
        met = active & si.is_valid()
        # A ray that goes down and ends nowhere crossed too many tiles along a groove.
        given_up = active & ~met & (direction.z <= 0)
        return Hit(si, met, None, mi.Color3f(1), given_up)

    def spawn(self, hit: Hit, direction: Any) -> Any:
        """Where a ray goes on from a hit."""
        return hit.si.spawn_ray(direction).o

    def sample(self, context: Any, hit: Hit, first: Any, second: Any, active: Any) -> Any:
        """A direction in the hit's frame and its weight, rgb.

        Where normals are interpolated a direction may go into the mesh although it leaves the
        shading frame's plane: that energy is lost, as it is in a renderer.
        """
        wo, weight = sampled(self.bsdfs, self.shares, context, hit, first, second, active)
        outside = dr.dot(hit.si.to_world(wo), hit.si.n) > 0
        return wo, dr.select(outside, weight, 0)
