"""Meshes made in code: a tessellated sphere and a draped cloth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.geometry.primitives import Mesh, Sphere


def grid_faces(rows: int, columns: int) -> NDArray[np.uint32]:
    """Triangles [2 rows columns, 3] of a grid of (rows + 1) x (columns + 1) vertices.

    Counter-clockwise where the column index grows to the right and the row index upwards.
    """
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (i * (columns + 1) + j).ravel()
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32)


def sphere_mesh(sphere: Sphere) -> Mesh:
    """``sphere`` as triangles with exact normals and its texture coordinates."""
    rows, columns = sphere.rows, 2 * sphere.rows
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    phi, theta = 2 * np.pi * u, np.pi * (1 - v)
    n = np.stack(
        [-np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], -1
    ).reshape(-1, 3)
    uv = np.stack([u * sphere.uv_scale[0], v * sphere.uv_scale[1]], -1).reshape(-1, 2)
    faces = grid_faces(rows, columns)
    # The first and last row of quads meet at a pole: half of their triangles have no area.
    corners = n[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    faces = faces[area > 1e-12]
    vertices = np.array(sphere.center) + sphere.radius * n
    return Mesh(
        vertices.astype(np.float32),
        faces,
        n.astype(np.float32),
        uv.astype(np.float32),
        sphere.tested,
        sphere.material,
    )


def _drape(x: NDArray, y: NDArray) -> NDArray:
    """Height of the cloth over its plane: folds that fan out from two pinned corners."""
    fall = 0.5 * (1 - y)  # 0 at the pinned upper edge, 1 at the hem
    height = np.zeros_like(x)
    for corner, phase in ((-1.0, 0.0), (1.0, 1.3)):
        angle = np.arctan2(x - 1.25 * corner, 1.9 - y)
        near = np.exp(-(((x - corner) / 1.1) ** 2))
        height += near * np.sin(14 * angle + phase)
    belly = np.exp(-((x / 0.55) ** 2 + ((y + 0.1) / 0.8) ** 2))
    return 0.2 * (0.35 + 0.65 * fall) * height + 0.16 * belly - 0.05 * np.cos(3.1 * x)


def cloth_mesh(texture_repeat: float = 2.0, cells: int = 160) -> Mesh:
    """A draped square of cloth over [-1, 1]^2, facing +z, with smooth normals.

    ``texture_repeat`` copies of the texture along each side; ``cells`` quads along each.
    """
    s = np.linspace(-1, 1, cells + 1)
    y, x = np.meshgrid(s, s, indexing="ij")
    step = 1e-4
    dx = (_drape(x + step, y) - _drape(x - step, y)) / (2 * step)
    dy = (_drape(x, y + step) - _drape(x, y - step)) / (2 * step)
    n = np.stack([-dx, -dy, np.ones_like(dx)], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    vertices = np.stack([x, y, _drape(x, y)], -1)
    uv = np.stack([x + 1, y + 1], -1) * (texture_repeat / 2)
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32),
        grid_faces(cells, cells),
        n.reshape(-1, 3).astype(np.float32),
        uv.reshape(-1, 2).astype(np.float32),
    )
