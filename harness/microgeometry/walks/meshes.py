"""One tile of a surface for walks as triangles, for a path tracer that knows nothing of walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import Unsupported
from harness.geometry.shapes import grid_faces
from harness.microgeometry.tile import Tile
from harness.microgeometry.walks.micro import MicroBSDF
from harness.microgeometry.walks.primitives import Primitives
from harness.microgeometry.walks.surface import WalkedSurface

Array = NDArray[np.float64]

ROWS = 24
"""Rows of triangles of a sphere from pole to pole; twice as many columns."""


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles that share a micro-BSDF, in widths of the tile over its ground or mean plane.

    ``vertices`` [V, 3]; ``faces`` [F, 3]; unit ``normals`` [V, 3], or None for flat faces; ``uv``
    [V, 2]; ``tint`` [V, 3] multiplies what the micro-BSDF reflects, None where it is one.
    """

    micro: MicroBSDF
    vertices: Array
    faces: NDArray[np.uint32]
    normals: Array | None
    uv: Array
    tint: Array | None = None

    @property
    def size_bytes(self) -> int:
        """Of its arrays in single precision, as a renderer holds them."""
        kept = (self.vertices, self.faces, self.normals, self.uv, self.tint)
        return sum(4 * array.size for array in kept if array is not None)


def parts(surface: WalkedSurface, rows: int = ROWS) -> list[Part]:
    """A tile of it; laid side by side, tiles close.

    Spheres and ellipsoids are bodies of triangles with smooth normals and the area of a sphere's;
    pyramids and height fields are what they are.

    Raises:
        Unsupported: its frame is turned texel by texel, which a mesh alone does not carry.
    """
    if isinstance(surface.shape, Tile):
        return [_heightfield(surface.shape, surface.micro)]
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
    # The level that walks start from is the mean height; the sheet is laid there.
    down = np.array([0, 0, surface.shape.mean_height])
    ground = Part(surface.ground, square - down, grid_faces(1, 1), None, square[:, :2])
    bed = _bed(surface.shape, surface.micro, rows)
    lowered = Part(bed.micro, bed.vertices - down, bed.faces, bed.normals, bed.uv, bed.tint)
    return [ground, lowered]


def _heightfield(tile: Tile, micro: MicroBSDF) -> Part:
    """Vertices at texel centres from the first to its copy in the next tile."""
    if tile.angle is not None or tile.micro is not None:
        raise Unsupported(f"{tile.name}: turned frames or micro normals are not in its mesh")
    n = tile.resolution
    index = np.arange(n + 1)
    wrapped = np.ix_(index % n, index % n)
    y, x = np.meshgrid((index + 0.5) / n, (index + 0.5) / n, indexing="ij")
    vertices = np.stack([x, y, tile.height[wrapped]], -1).reshape(-1, 3)
    normals = None
    if tile.smooth:
        du, dv = (np.roll(tile.height, -1, k) - np.roll(tile.height, 1, k) for k in (1, 0))
        normals = np.stack([-du * n / 2, -dv * n / 2, np.ones_like(tile.height)], -1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        normals = normals[wrapped].reshape(-1, 3)
    return Part(micro, vertices, grid_faces(n, n), normals, vertices[:, :2])


def _bed(bed: Primitives, micro: MicroBSDF, rows: int) -> Part:
    if bed.shape == "pyramid":
        unit, faces, unit_normals = *_pyramid(), None
    else:
        unit, faces = _sphere(rows)
        unit_normals = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    vertices = bed.centre[:, None] + np.einsum("nij,vj->nvi", bed.axes, unit)
    normals = None
    if unit_normals is not None:
        # Normals go by the transpose of the inverse.
        normals = np.einsum("nji,vj->nvi", np.linalg.inv(bed.axes), unit_normals)
        normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).reshape(-1, 3)
    count = len(unit)
    shifted = faces[None] + count * np.arange(len(bed.centre), dtype=np.uint32)[:, None, None]
    flat = vertices.reshape(-1, 3)
    tint = None if (bed.tint == 1).all() else np.repeat(bed.tint, count, 0)
    return Part(micro, flat, shifted.reshape(-1, 3).astype(np.uint32), normals, flat[:, :2], tint)


def _sphere(rows: int) -> tuple[Array, NDArray[np.uint32]]:
    theta, phi = np.meshgrid(
        np.linspace(np.pi, 0, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1), indexing="ij"
    )
    unit = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    unit, faces = unit.reshape(-1, 3), grid_faces(rows, 2 * rows)
    corners = unit[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    # A convex body is met in proportion to its area (Cauchy): that is to be the sphere's.
    return unit * np.sqrt(4 * np.pi / (area.sum() / 2)), faces[area > 1e-12]


def _pyramid() -> tuple[Array, NDArray[np.uint32]]:
    """Four sides over the base |x|, |y| <= 1; the base lies on the ground and is left out."""
    base = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    return np.array([*base, [0, 0, 1]], float), np.array(faces, np.uint32)
