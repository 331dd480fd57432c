"""Rays against a bed of primitives that repeats for ever, by a walk through the cells of its tile.

Every cell of a regular grid over the tile lists the primitives whose boxes reach into it, each by
its place relative to the cell, so that the tile has no edge: a ray goes from cell to cell, and the
grid's indices wrap. Spheres, ellipsoids and pyramids are met exactly and not as triangles.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from harness.microgeometry.walks.hits import Hit, sampled
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.primitives import Primitives

CROSSINGS = 4096
"""Steps from primitive to primitive or cell to cell after which a ray is given up, and counted."""

_ITSELF = 1e-4
"""In units of a primitive's size: what a ray meets so near is where it starts. Primitives are
convex, so that no ray meets the one that it leaves."""


class Bed:
    """:class:`Primitives` over a ground, for rays of one device.

    The frame of its rays is that of the tile, in widths of a cell: x = u G, y = v G, with G cells
    along each side; z = 0 is the ground.
    """

    def __init__(
        self, mi: Any, primitives: Primitives, micro: MicroBSDF, ground: MicroBSDF, reference: float
    ):
        self.mi, self.pyramids = mi, primitives.shape == "pyramid"
        both = [micro] if ground == micro else [micro, ground]
        self.bsdfs = [one.load(mi) for one in both]
        self.shares = [mi.Color3f(*one.reflectance) for one in both]
        # About one primitive a cell, none of which is larger than the tile.
        self.cells = max(1, round(len(primitives.centre) ** 0.5))
        self.top = primitives.top * self.cells
        self.reference = reference * self.cells
        start, rows = _listed(primitives, self.cells)
        self.start = mi.UInt32(start)
        self.rows = mi.Float(rows.ravel())

    def first(self, u: Any, v: Any, wi: Any) -> Any:
        """Where a ray against ``wi`` through (u, v) of the reference plane comes in from above."""
        t = (self.top - self.reference) / wi.z
        x, y = u * self.cells + t * wi.x, v * self.cells + t * wi.y
        return self._into_tile(self.mi.Point3f(x, y, self.top))

    def spawn(self, hit: Hit, direction: Any) -> Any:
        """Where a ray goes on from a hit."""
        return self._into_tile(hit.si.p)

    def hit(self, origin: Any, direction: Any, active: Any) -> Hit:
        """The first thing that a ray meets."""
        mi = self.mi
        end = dr.select(direction.z > 0, self.top - origin.z, -origin.z) / direction.z
        # A ray along the ground never comes to its end.
        end = dr.select(direction.z == 0, dr.inf, end)
        t, row, corner, given_up = self._nearest(origin, direction, end, active)
        met = active & (t < dr.inf)
        ground = active & ~met & ~given_up & (direction.z < 0)
        t = dr.select(met, t, dr.select(ground, end, 0))
        packets = self._packets(row, met)
        local = origin - mi.Point3f(corner.x, corner.y, 0) + t * direction - packets.centre
        normal = dr.select(met, self._normal(packets, local), mi.Normal3f(0, 0, 1))
        si = dr.zeros(mi.SurfaceInteraction3f)
        p = origin + t * direction
        si.p = mi.Point3f(p.x, p.y, dr.select(ground, 0, p.z))
        si.t, si.n = t, normal
        si.sh_frame = mi.Frame3f(normal)
        si.wi = si.to_local(-direction)
        tint = dr.select(met, packets.tint, mi.Color3f(1))
        return Hit(si, met | ground, ground if len(self.bsdfs) > 1 else None, tint, given_up)

    def sample(self, context: Any, hit: Hit, first: Any, second: Any, active: Any) -> Any:
        """A direction in the hit's frame and its weight, rgb, by the micro-BSDF there."""
        return sampled(self.bsdfs, self.shares, context, hit, first, second, active)

    @dr.syntax
    def _nearest(self, o, d, end, active):
        """(distance or infinity, row, the corner of its cell, whether the ray was given up)."""
        mi = self.mi
        corner = mi.Point2f(dr.floor(o.x), dr.floor(o.y))
        at = mi.Point2i(corner)
        at = dr.select(at >= self.cells, at - self.cells, at)
        forward = mi.Vector2f(dr.select(d.x > 0, 1, 0), dr.select(d.y > 0, 1, 0))
        inverse = mi.Vector2f(dr.rcp(d.x), dr.rcp(d.y))
        moves = mi.Mask(d.x != 0), mi.Mask(d.y != 0)
        step = mi.Point2i(dr.select(d.x > 0, 1, -1), dr.select(d.y > 0, 1, -1))
        next_x = dr.select(moves[0], (corner.x + forward.x - o.x) * inverse.x, dr.inf)
        next_y = dr.select(moves[1], (corner.y + forward.y - o.y) * inverse.y, dr.inf)
        best, found, of = mi.Float(dr.inf), mi.UInt32(0), mi.Point2f(corner)
        which, count = mi.UInt32(0), mi.UInt32(0)
        going = mi.Mask(active)
        while going:
            cell = mi.UInt32(at.y) * self.cells + mi.UInt32(at.x)
            first = dr.gather(mi.UInt32, self.start, cell, going)
            last = dr.gather(mi.UInt32, self.start, cell + 1, going)
            row = first + which
            some = going & (row < last)
            t = self._meet(row, o - mi.Point3f(corner.x, corner.y, 0), d, some)
            nearer = some & (t < best)
            best = dr.select(nearer, t, best)
            found = dr.select(nearer, row, found)
            of = dr.select(nearer, corner, of)
            which += 1
            leave = dr.minimum(next_x, next_y)
            through = row + 1 >= last
            count += 1
            # A hit in another cell, of a primitive that reaches into this one, may not be the
            # first.
            going &= ~(through & ((best <= leave) | (leave >= end))) & (count < CROSSINGS)
            along_x = next_x < next_y
            move_x, move_y = through & along_x, through & ~along_x
            corner.x += dr.select(move_x, mi.Float(step.x), 0)
            corner.y += dr.select(move_y, mi.Float(step.y), 0)
            at.x += dr.select(move_x, step.x, 0)
            at.y += dr.select(move_y, step.y, 0)
            at = dr.select(at < 0, at + self.cells, at)
            at = dr.select(at >= self.cells, at - self.cells, at)
            next_x += dr.select(move_x, dr.abs(inverse.x), 0)
            next_y += dr.select(move_y, dr.abs(inverse.y), 0)
            which = dr.select(through, 0, which)
        given_up = active & (count >= CROSSINGS)
        best = dr.select(best < end, best, dr.inf)
        return dr.select(given_up, dr.inf, best), found, of, given_up

    def _meet(self, row: Any, o: Any, d: Any, active: Any) -> Any:
        """Distance to where a ray enters the primitive of ``row``, infinity if it does not."""
        packets = self._packets(row, active, tint=False)
        p, v = packets.inside(o - packets.centre), packets.inside(d)
        if self.pyramids:
            return _enter_pyramid(p, v)
        return _enter_sphere(p, v)

    def _normal(self, packets: _Packets, local: Any) -> Any:
        """Unit normal at ``local``, relative to the primitive's centre."""
        mi = self.mi
        p = packets.inside(local)
        if self.pyramids:
            along_x = dr.abs(p.x) > dr.abs(p.y)
            side_x = dr.select(along_x, dr.sign(p.x), 0)
            side_y = dr.select(along_x, 0, dr.sign(p.y))
            p = mi.Vector3f(side_x, side_y, 1)
        # Normals go by the transpose of the inverse.
        return mi.Normal3f(dr.normalize(packets.outwards(p)))

    def _packets(self, row: Any, active: Any, tint: bool = True) -> _Packets:
        packet = _packet_type(self.mi)
        found = []
        for k in range(4 if tint else 3):
            found += list(dr.gather(packet, self.rows, row * 4 + k, active))
        return _Packets(self.mi, found)

    def _into_tile(self, p: Any) -> Any:
        g = self.cells
        x, y = p.x - g * dr.floor(p.x / g), p.y - g * dr.floor(p.y / g)
        return self.mi.Point3f(x, y, p.z)


class _Packets:
    """One row: centre relative to the cell (3), map to the unit shape (9), tint (3)."""

    def __init__(self, mi: Any, values: list[Any]):
        self.mi, self.map = mi, values[3:12]
        self.centre = mi.Vector3f(*values[:3])
        self.tint = mi.Color3f(*values[12:15]) if len(values) > 12 else None

    def inside(self, v: Any) -> Any:
        """``v`` in the coordinates of the unit shape."""
        m = self.map
        return self.mi.Vector3f(
            *(dr.fma(m[k], v.x, dr.fma(m[k + 1], v.y, m[k + 2] * v.z)) for k in (0, 3, 6))
        )

    def outwards(self, v: Any) -> Any:
        """The transpose."""
        m = self.map
        return self.mi.Vector3f(
            *(dr.fma(m[k], v.x, dr.fma(m[k + 3], v.y, m[k + 6] * v.z)) for k in (0, 1, 2))
        )


def _enter_sphere(p: Any, v: Any) -> Any:
    """Where p + t v enters the unit sphere from outside, or infinity."""
    a, b = dr.dot(v, v), dr.dot(p, v)
    # The discriminant by the nearest point of the ray: no difference of large squares.
    near = p - (b / a) * v
    rest = 1 - dr.dot(near, near)
    t = (-b - dr.sqrt(dr.maximum(rest, 0) * a)) / a
    return dr.select((rest > 0) & (t * dr.sqrt(a) > _ITSELF), t, dr.inf)


def _enter_pyramid(p: Any, v: Any) -> Any:
    """Where p + t v enters the unit pyramid from outside, or infinity."""
    near, far = -dr.inf, dr.inf
    off = False
    for along in ("x", "y"):
        for side in (1, -1):
            place, speed = getattr(p, along), getattr(v, along)
            left = 1 - side * place - p.z
            rate = side * speed + v.z
            t = left / rate
            near = dr.maximum(near, dr.select(rate < 0, t, -dr.inf))
            far = dr.minimum(far, dr.select(rate > 0, t, dr.inf))
            off |= (rate == 0) & (left < 0)
    # The base, z = 0, lies on the ground or below it: no ray comes from there.
    met = (near < far) & (near * dr.norm(v) > _ITSELF) & (p.z + near * v.z >= 0) & ~off
    return dr.select(met, near, dr.inf)


def _listed(primitives: Primitives, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """First rows of each cell [cells^2 + 1] and rows [M, 16], lengths in widths of a cell."""
    centre, half = primitives.centre * cells, primitives.half_extent * cells
    inverse = np.linalg.inv(primitives.axes * cells).reshape(-1, 9)
    lists: list[list[np.ndarray]] = [[] for _ in range(cells * cells)]
    # Rounding in the kernel may put a hit on the other side of a cell's edge.
    margin = 1e-3
    for at, size, matrix, tint in zip(centre, half, inverse, primitives.tint, strict=True):
        low = np.floor(at[:2] - size[:2] - margin).astype(int)
        high = np.floor(at[:2] + size[:2] + margin).astype(int)
        for y in range(low[1], high[1] + 1):
            for x in range(low[0], high[0] + 1):
                here = np.concatenate([at - [x, y, 0], matrix, tint, [0]])
                lists[(y % cells) * cells + x % cells].append(here)
    start = np.concatenate([[0], np.cumsum([len(part) for part in lists])]).astype(np.uint32)
    rows = np.array([row for part in lists for row in part], np.float32)
    return start, rows


def _packet_type(mi: Any) -> Any:
    """Four floats, as one gather returns them."""
    if dr.backend_v(mi.Float) == dr.JitBackend.CUDA:
        from drjit.cuda.ad import Array4f
    else:
        from drjit.llvm.ad import Array4f
    return Array4f
