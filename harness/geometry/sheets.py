"""A square sheet laid with flat tiles, plain or bent along a cylinder."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.geometry.primitives import Mesh
from harness.geometry.shapes import grid_faces


def tiled_sheet(
    tiles: int,
    bend: float = 0.0,
    tilt: float = 0.0,
    turn: float = 0.0,
    cells: int = 1,
    **material: Any,
) -> Mesh:
    """``tiles``^2 squares of ``cells``^2 cells each, of width two together, that face +z.

    ``bend`` degrees, towards the viewer in the middle, are spread over the edges between columns of
    tiles; each tile stays a flat square, so that what is laid on it is not stretched. Then the
    sheet leans back by ``tilt`` degrees about x and turns by ``turn`` about y. ``u`` grows along +x
    and ``v`` along +y, by one a tile. Faces are flat: ``normals`` is None.
    """
    angle = np.deg2rad(bend) * ((np.arange(tiles) + 0.5) / tiles - 0.5)
    width = 2 / tiles
    corner = np.concatenate(
        [[[0.0, 0.0]], np.cumsum(width * np.stack([np.cos(angle), -np.sin(angle)], -1), 0)]
    )
    corner -= (corner.min(0) + corner.max(0)) / 2
    u = np.linspace(0, tiles, tiles * cells + 1)
    across = np.stack([np.interp(u, np.arange(tiles + 1), corner[:, k]) for k in range(2)], -1)
    rows, columns = np.meshgrid(u, u, indexing="ij")
    x, z = np.broadcast_to(across, (len(u), *across.shape)).transpose(2, 0, 1)
    position = np.stack([x, rows * width - 1, z], -1).reshape(-1, 3)
    return Mesh(
        (position @ _rotation(tilt, turn).T).astype(np.float32),
        grid_faces(len(u) - 1, len(u) - 1),
        None,
        np.stack([columns, rows], -1).reshape(-1, 2).astype(np.float32),
        **material,
    )


def tile_frames(mesh: Mesh) -> NDArray[np.float64]:
    """Where each tile of a mesh lies: [N, 3, 4], columns along u, along v, normal, and corner.

    A tile is a square of whole texture coordinates with vertices at its corners. The normal is as
    long as the tile's sides, so that a frame takes a tile [0, 1)^2 with heights in its own widths
    to its place.

    Raises:
        ValueError: the mesh is not made of flat squares of whole texture coordinates.
    """
    whole = np.abs(mesh.uv - np.round(mesh.uv)).max(1) < 1e-4
    at = {
        (int(round(float(u))), int(round(float(v)))): p
        for (u, v), p in zip(mesh.uv[whole], mesh.vertices[whole].astype(float), strict=True)
    }
    frames = []
    for (u, v), corner in at.items():
        if (u + 1, v + 1) not in at:
            continue
        if (u + 1, v) not in at or (u, v + 1) not in at:
            raise ValueError("a corner of a tile is missing")
        along, up = at[u + 1, v] - corner, at[u, v + 1] - corner
        side = np.linalg.norm(along)
        off = np.linalg.norm(corner + along + up - at[u + 1, v + 1])
        uneven = abs(np.linalg.norm(up) - side) + abs(along @ up) / side
        if not max(off, uneven) < 1e-4 * side:
            raise ValueError("a tile is not a flat square")
        frames.append(np.stack([along, up, np.cross(along, up) / side, corner], -1))
    if not frames:
        raise ValueError("there is no square of whole texture coordinates")
    return np.stack(frames)


def _rotation(tilt: float, turn: float) -> NDArray[np.float64]:
    a, b = np.deg2rad([-tilt, turn])
    about_x = [[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]
    about_y: Sequence = [[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]]
    return np.array(about_y) @ np.array(about_x)
