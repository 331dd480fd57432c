"""Solids made in code: turned on a lathe, boxes with round edges, rings, panels, a runner.

All meshes are wound counter-clockwise seen from outside, with dp_du x dp_dv along the normal.
Texture coordinates are lengths times ``repeat`` (copies of the texture per unit of length).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.geometry.primitives import Mesh
from harness.geometry.shapes import grid_faces

Points = Sequence[tuple[float, float]]


def smooth(points: Points, count: int) -> NDArray:
    """[count, 2] points at equal lengths on the Catmull-Rom spline through ``points``."""
    p = np.asarray(points, float)
    ends = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0, 1, 24, endpoint=False)[:, None]
    pieces = []
    for a, b, c, d in zip(ends, ends[1:], ends[2:], ends[3:], strict=False):
        pieces.append(
            0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2
                   + (3 * b - a - 3 * c + d) * t**3)
        )  # fmt: skip
    curve = np.concatenate([*pieces, p[-1:]])
    length = np.concatenate([[0], np.linalg.norm(np.diff(curve, axis=0), axis=1).cumsum()])
    at = np.linspace(0, length[-1], count)
    return np.stack([np.interp(at, length, curve[:, k]) for k in range(2)], -1)


def turned(
    profile: Points,
    center: Sequence[float] = (0.0, 0.0, 0.0),
    repeat: float = 1.0,
    detail: float = 1.0,
    **material: Any,
) -> Mesh:
    """``profile``, (radius, height) from the foot to the top, turned around the y axis.

    The solid lies to the left of the way along the profile, so that one that turns inwards at
    the rim and goes down again makes a bowl. A radius is zero at most where it ends.
    """
    rows, columns = max(8, int(96 * detail)), max(12, int(128 * detail))
    p = smooth(profile, rows + 1)
    p[:, 0] = np.maximum(p[:, 0], 0)  # the spline may swing past the axis at the foot
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    v = np.concatenate([[0], np.linalg.norm(np.diff(p, axis=0), axis=1).cumsum()]) * repeat
    around = 2 * np.pi * np.linspace(0, 1, columns + 1)
    out = np.stack([-np.sin(around), 0 * around, -np.cos(around)], -1)[None]
    up = np.array([0.0, 1.0, 0.0])
    position = p[:, None, :1] * out + p[:, None, 1:] * up + np.asarray(center)
    normal = tangent[:, None, 1:] * out - tangent[:, None, :1] * up
    turns = max(1.0, round(2 * np.pi * p[:, 0].max() * repeat))
    uv = np.stack(np.broadcast_arrays(around[None] / (2 * np.pi) * turns, v[:, None]), -1)
    return _mesh(position, normal, uv, rows, columns, **material)


def ring(
    radius: float,
    tube: float,
    center: Sequence[float],
    tilt: float = 0.0,
    repeat: float = 1.0,
    detail: float = 1.0,
    **material: Any,
) -> Mesh:
    """A torus around the y axis, tilted by ``tilt`` degrees towards the viewer at +z."""
    rows, columns = int(48 * detail), int(96 * detail)
    around = 2 * np.pi * np.linspace(0, 1, columns + 1)[None]
    across = 2 * np.pi * np.linspace(0, 1, rows + 1)[:, None]
    out = np.stack([-np.sin(around), 0 * around, -np.cos(around)], -1)
    normal = np.cos(across)[..., None] * out
    normal = normal + np.sin(across)[..., None] * np.array([0.0, 1.0, 0.0])
    position = radius * out + tube * normal
    a = np.deg2rad(tilt)
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    uv = np.stack(
        np.broadcast_arrays(
            around / (2 * np.pi) * round(2 * np.pi * radius * repeat),
            across / (2 * np.pi) * max(1, round(2 * np.pi * tube * repeat)),
        ),
        -1,
    )
    return _mesh(
        position @ turn.T + np.asarray(center), normal @ turn.T, uv, rows, columns, **material
    )


def box(
    size: Sequence[float],
    center: Sequence[float],
    edge: float = 0.05,
    turn: float = 0.0,
    lean: float = 0.0,
    repeat: float = 1.0,
    detail: float = 1.0,
    **material: Any,
) -> Mesh:
    """A box of ``size`` with edges rounded by ``edge``.

    It leans by ``lean`` degrees around z, then is turned by ``turn`` degrees around y.
    """
    half = np.asarray(size, float) / 2
    bevel = max(2, int(6 * detail))
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            # s x t along the outward normal, for either side.
            s, t = ((axis + 1) % 3, (axis + 2) % 3)[:: int(sign)]
            lines = [_beveled(half[k], edge, bevel) for k in (s, t)]
            y, x = np.meshgrid(lines[1], lines[0], indexing="ij")
            cube = np.empty((*x.shape, 3))
            cube[..., axis], cube[..., s], cube[..., t] = sign * half[axis], x, y
            inner = np.clip(cube, edge - half, half - edge)
            normal = cube - inner
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
            uv = np.stack([x + half[s], y + half[t]], -1) * repeat
            rows, columns = x.shape[0] - 1, x.shape[1] - 1
            parts.append(_mesh(inner + edge * normal, normal, uv, rows, columns))
    a, b = np.deg2rad([turn, lean])
    leaning = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    turned_ = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    return _joined(parts, turned_ @ leaning, np.asarray(center, float), **material)


def panel(
    corner: Sequence[float],
    along: Sequence[float],
    up: Sequence[float],
    repeat: float = 1.0,
    **material: Any,
) -> Mesh:
    """A flat parallelogram that faces ``along`` x ``up``."""
    corner, along, up = (np.asarray(v, float) for v in (corner, along, up))
    s, t = (np.array([0.0, 1.0]) for _ in range(2))
    t, s = np.meshgrid(t, s, indexing="ij")
    position = corner + s[..., None] * along + t[..., None] * up
    normal = np.cross(along, up)
    normal = np.broadcast_to(normal / np.linalg.norm(normal), position.shape)
    lengths = np.array([np.linalg.norm(along), np.linalg.norm(up)])
    return _mesh(position, normal, np.stack([s, t], -1) * lengths * repeat, 1, 1, **material)


def runner(
    width: float,
    back: float,
    front: float,
    drop: float,
    center: Sequence[float] = (0.0, 0.0, 0.0),
    repeat: float = 1.0,
    detail: float = 1.0,
    **material: Any,
) -> Mesh:
    """A cloth that lies on a table from z = ``back`` to ``front`` and hangs over its edge.

    It hangs down by ``drop`` in folds; ``center`` is on the table top.
    """
    rows, columns = int(160 * detail), int(96 * detail)
    bend, lift = 0.1, 0.012
    flat, arc = front - back, bend * np.pi / 2
    s = np.linspace(0, flat + arc + drop, rows + 1)[:, None]
    x = np.linspace(-width / 2, width / 2, columns + 1)[None]
    angle = np.clip((s - flat) / bend, 0, np.pi / 2)
    hanging = np.maximum(s - flat - arc, 0)
    fall = hanging / drop

    def point(x: NDArray) -> NDArray:
        fold = 0.10 * fall * np.sin(5.2 * x + 0.9) + 0.05 * fall**2 * np.sin(11.0 * x)
        wave = 0.010 * (1 + np.sin(2.1 * x + 1.7 * s)) * np.cos(angle)
        z = back + np.minimum(s, flat) + bend * np.sin(angle) + fold + 0.03 * fall
        y = lift + wave - bend * (1 - np.cos(angle)) - hanging
        x = x * (1 - 0.06 * fall) + 0 * s
        return np.stack(np.broadcast_arrays(x, y, z), -1)

    position = point(x)
    step = 1e-3
    across = (point(x + step) - point(x - step)) / (2 * step)
    along = np.gradient(position, axis=0)
    # v runs from the hem up to the table's back, so that the pattern stands upright.
    normal = np.cross(across, -along)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    v = (s[-1] - s) * repeat
    uv = np.stack(np.broadcast_arrays((x + width / 2) * repeat, v), -1)
    flip = slice(None, None, -1)
    return _mesh(
        position[flip] + np.asarray(center), normal[flip], uv[flip], rows, columns, **material
    )


def _beveled(half: float, edge: float, bevel: int) -> NDArray:
    """Grid lines across a face of a box: dense where the edge is round."""
    # Equal angles on the round edge: the tangent of the angle is a line's place on the face.
    rim = edge * np.tan(np.linspace(0, np.pi / 4, bevel + 1))
    inner = np.linspace(edge - half, half - edge, 5)[1:-1]
    return np.concatenate([edge - half - rim[::-1], inner, half - edge + rim])


def _joined(parts: Sequence[Mesh], turn: NDArray, center: NDArray, **material: Any) -> Mesh:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return Mesh(
        (np.concatenate([p.vertices for p in parts]) @ turn.T + center).astype(np.float32),
        np.concatenate([p.faces + n for p, n in zip(parts, starts, strict=True)]).astype(np.uint32),
        (np.concatenate([p.normals for p in parts]) @ turn.T).astype(np.float32),
        np.concatenate([p.uv for p in parts]),
        **material,
    )


def _mesh(
    position: NDArray, normal: NDArray, uv: NDArray, rows: int, columns: int, **material: Any
) -> Mesh:
    """A grid of (rows + 1) x (columns + 1) points; faces without area (at a pole) are left out."""
    position, normal = position.reshape(-1, 3), normal.reshape(-1, 3)
    faces = grid_faces(rows, columns)
    corners = position[faces]
    sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(*sides), axis=1)
    return Mesh(
        position.astype(np.float32),
        faces[area > 1e-12],
        normal.astype(np.float32),
        uv.reshape(-1, 2).astype(np.float32),
        **material,
    )
