"""Rays against a tile that repeats for ever, and the path estimator on it.

The mesh covers the tile and a margin around it. A ray that leaves the mesh sideways while
it is still between the lowest and the highest point goes on at the same place of the tile, so
that the surface has no end, whatever the angle.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from harness.geometry.shapes import grid_faces
from harness.microgeometry.tile import Tile
from harness.mitsuba_runtime.bitmaps import with_bitmaps
from harness.mitsuba_runtime.variant import use
from harness.textures.maps import bitmap

MARGIN = 4
"""The mesh goes on for 1 / MARGIN of a tile on each side."""

CROSSINGS = 256
"""A ray that has crossed so many tiles without a hit is taken to leave.

A ray along a groove would go on for ever. What is cut off has a slope of less than
``depth / (CROSSINGS / 2)``: for a relief of 0.05 tiles a cosine of 4e-4, which a direction
uniform on the disk has with a probability of 2e-7.
"""


class Tracer:
    """A :class:`~harness.microgeometry.tile.Tile` as a Mitsuba scene.

    Everything it offers works on Dr.Jit arrays of one variant, inside or outside of symbolic
    loops, in the frame of the tile: x = u, y = v, z = height, lengths in widths of the tile.
    """

    def __init__(self, surface: Tile, device: str):
        mi = self.mi = use(device)
        self.context = mi.BSDFContext()
        self.bsdf = mi.load_dict(with_bitmaps(mi, dict(surface.bsdf)))
        flags = self.bsdf.flags()
        if mi.has_flag(flags, mi.BSDFFlags.Delta) or mi.has_flag(flags, mi.BSDFFlags.Transmission):
            raise ValueError(f"{surface.name}: expected a reflection without delta lobes")
        self.angle, self.micro = None, None
        if surface.angle is not None:
            # Directions along and against the tangent are one: double angles interpolate.
            twice = np.stack([np.cos(2 * surface.angle), np.sin(2 * surface.angle)], -1)
            self.angle = self._texture(np.concatenate([twice, 0 * twice[..., :1]], -1))
        if surface.micro is not None:
            self.micro = self._texture(surface.micro)
        # Clear of the surface by less than a texel, so that no ray starts on it.
        lift = 1e-3
        self.top = float(surface.height.max()) + lift
        self.bottom = float(surface.height.min()) - lift
        rows = surface.resolution
        margin = rows // MARGIN
        # Between the first and last vertices, which are texel centres.
        self.low, self.high = (1 - margin) / rows, (rows + margin - 1) / rows
        self.scene = mi.load_dict({"type": "scene", "surface": self._mesh(surface, margin)})

    def _texture(self, values: Any) -> Any:
        mi = self.mi
        node = {**bitmap(np.zeros((1, 1))), "array": np.ascontiguousarray(values, np.float32)}
        return mi.load_dict(with_bitmaps(mi, node))

    def _mesh(self, surface: Tile, margin: int) -> Any:
        mi, rows = self.mi, surface.resolution
        index = np.arange(-margin, rows + margin)
        at = (index + 0.5) / rows
        wrapped = np.ix_(index % rows, index % rows)
        y, x = np.meshgrid(at, at, indexing="ij")
        vertices = np.stack([x, y, surface.height[wrapped]], -1)
        mesh = mi.Mesh(
            surface.name,
            vertex_count=len(at) ** 2,
            face_count=2 * (len(at) - 1) ** 2,
            has_vertex_normals=surface.smooth,
            has_vertex_texcoords=True,
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ravel(vertices).astype(np.float32)
        parameters["faces"] = mi.UInt32(np.ravel(grid_faces(len(at) - 1, len(at) - 1)))
        parameters["vertex_texcoords"] = np.ravel(np.stack([x, y], -1)).astype(np.float32)
        if surface.smooth:
            normals = _normals(surface.height)[wrapped]
            parameters["vertex_normals"] = np.ravel(normals).astype(np.float32)
        parameters.update()
        return mesh

    # --- rays ----------------------------------------------------------------------------

    def start(self, u: Any, v: Any, direction: Any) -> Any:
        """Origins above the surface of rays that go against ``direction`` through (u, v, 0)."""
        mi = self.mi
        t = self.top / direction.z
        return mi.Point3f(
            _into_tile(u + t * direction.x), _into_tile(v + t * direction.y), self.top
        )

    def intersect(self, ray: Any, active: Any) -> Any:
        """The first hit of ``ray``, with its shading frame; not valid where it leaves."""
        mi = self.mi
        si = dr.zeros(mi.SurfaceInteraction3f)
        found, origin = self._first_hit(ray, active)
        last = mi.Ray3f(origin, ray.d)
        last.maxt = dr.select(found.is_valid(), dr.largest(mi.Float), 0)
        si = found.compute_surface_interaction(last, mi.RayFlags.All, active & found.is_valid())
        self._set_frame(si, ray.d)
        return si

    @dr.syntax
    def _first_hit(self, ray, active):
        """``(preliminary intersection, origin of the last leg)``, leg by leg."""
        mi = self.mi
        origin = mi.Point3f(ray.o)
        found = dr.zeros(mi.PreliminaryIntersection3f)
        go_on = mi.Mask(active)
        crossings = mi.UInt32(0)
        while go_on:
            length, sideways = self._leg(origin, ray.d)
            leg = mi.Ray3f(origin, ray.d)
            leg.maxt = length
            hit = self.scene.ray_intersect_preliminary(leg, False, go_on)
            found = hit
            crossings += 1
            go_on &= ~hit.is_valid() & sideways & (crossings < CROSSINGS)
            origin = dr.select(go_on, self._next_leg(origin, ray.d, length), origin)
        return found, origin

    @dr.syntax
    def blocked(self, ray, active):
        """Whether ``ray`` meets the surface before it leaves: a mask."""
        mi = self.mi
        origin = mi.Point3f(ray.o)
        hit = mi.Mask(False)
        go_on = mi.Mask(active)
        crossings = mi.UInt32(0)
        while go_on:
            length, sideways = self._leg(origin, ray.d)
            leg = mi.Ray3f(origin, ray.d)
            leg.maxt = length
            hit = hit | self.scene.ray_test(leg, False, go_on)
            crossings += 1
            go_on &= ~hit & sideways & (crossings < CROSSINGS)
            origin = dr.select(go_on, self._next_leg(origin, ray.d, length), origin)
        return hit

    def _leg(self, o: Any, d: Any) -> tuple[Any, Any]:
        """Length of the ray to the end of the mesh or of the slab, and which: (t, sideways)."""

        def until(position: Any, step: Any, low: float, high: float) -> Any:
            end = dr.select(step > 0, high, low)
            return dr.select(step == 0, dr.inf, (end - position) / step)

        lateral = dr.minimum(
            until(o.x, d.x, self.low, self.high), until(o.y, d.y, self.low, self.high)
        )
        vertical = until(o.z, d.z, self.bottom, self.top)
        return dr.minimum(lateral, vertical), lateral < vertical

    def _next_leg(self, o: Any, d: Any, length: Any) -> Any:
        p = o + length * d
        return self.mi.Point3f(_into_tile(p.x), _into_tile(p.y), p.z)

    def _set_frame(self, si: Any, direction: Any) -> None:
        """Turn the frame by ``micro`` and ``angle`` and express ``wi`` in it."""
        mi = self.mi
        if self.angle is None and self.micro is None:
            return
        n, s = mi.Vector3f(si.sh_frame.n), mi.Vector3f(si.sh_frame.s)
        if self.micro is not None:
            n = si.sh_frame.to_world(dr.normalize(mi.Vector3f(self.micro.eval_3(si))))
            s = dr.normalize(s - n * dr.dot(n, s))
        t = dr.cross(n, s)
        if self.angle is not None:
            twice = self.angle.eval_3(si)
            sine, cosine = dr.sincos(0.5 * dr.atan2(twice[1], twice[0]))
            s, t = s * cosine + t * sine, t * cosine - s * sine
        si.sh_frame = mi.Frame3f(s, t, n)
        si.wi = si.to_local(-direction)

    # --- paths ---------------------------------------------------------------------------

    @dr.syntax
    def radiance(self, origin, direction, light, random, depth):
        """Radiance against ``direction`` for light of unit irradiance across its beam: Color3f.

        ``direction`` (going down) and ``light`` (towards the light) are unit vectors. Light is
        sampled at every vertex, the BSDF for the next one, for up to ``depth`` bounces. One
        path per lane; ``random`` is a PCG32.
        """
        mi = self.mi
        total, throughput = mi.Color3f(0), mi.Color3f(1)
        ray = mi.Ray3f(origin, direction)
        active = mi.Mask(True)
        bounce = mi.UInt32(0)
        depth = mi.UInt32(depth)
        while active:
            si = self.intersect(ray, active)
            active &= si.is_valid()
            value = self.bsdf.eval(self.context, si, si.to_local(light), active)
            value = dr.select(active, throughput * value, 0)
            lit = active & dr.any(value != 0)
            dark = self.blocked(si.spawn_ray(light), lit)
            total += dr.select(lit & ~dark, value, 0)
            bounce += 1
            active &= bounce < depth
            first = random.next_float32(active)
            second = mi.Point2f(random.next_float32(active), random.next_float32(active))
            taken, weight = self.bsdf.sample(self.context, si, first, second, active)
            throughput *= weight
            active &= dr.any(throughput != 0)
            ray = si.spawn_ray(si.to_world(taken.wo))
        return total

    @dr.syntax
    def energy(self, origin, direction, random, depth):
        """Radiance against ``direction`` under a sky of unit radiance all around: Color3f.

        The integral over the disk of what :meth:`radiance` gives per unit irradiance on the
        reference plane, without the choice of a light: a path counts where it leaves upwards.
        """
        mi = self.mi
        total, throughput = mi.Color3f(0), mi.Color3f(1)
        ray = mi.Ray3f(origin, direction)
        active = mi.Mask(True)
        bounce = mi.UInt32(0)
        depth = mi.UInt32(depth)
        while active:
            si = self.intersect(ray, active)
            free = active & ~si.is_valid() & (bounce > 0) & (ray.d.z > 0)
            total += dr.select(free, throughput, 0)
            active &= si.is_valid() & (bounce < depth)
            bounce += 1
            first = random.next_float32(active)
            second = mi.Point2f(random.next_float32(active), random.next_float32(active))
            taken, weight = self.bsdf.sample(self.context, si, first, second, active)
            throughput *= weight
            active &= dr.any(throughput != 0)
            ray = si.spawn_ray(si.to_world(taken.wo))
        return total


def _into_tile(x: Any) -> Any:
    return x - dr.floor(x)


def _normals(height: np.ndarray) -> np.ndarray:
    """Unit normals [R, R, 3] at the texel centres, by central differences."""
    from harness.textures.maps import normals

    return normals(height, 1.0)
