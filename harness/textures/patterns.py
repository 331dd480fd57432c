"""Man-made patterns, all tileable: weaves, tiles, planks, panels, rivets, scratches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from harness.textures.noise import Field, grid


class Weave(NamedTuple):
    """Woven threads; fields [size, size]."""

    height: Field
    """Height of the upper thread in [0, 1]."""
    warp: Field
    """1 where a warp thread (running along v) is on top, else 0."""
    across: Field
    """Position across the upper thread, in [-1, 1]."""
    thread: Field
    """A random number in [0, 1) of the upper thread."""


def weave(size: int, over: np.ndarray, threads: int, seed: int) -> Weave:
    """A weave of ``threads`` x ``threads``; ``over`` [m, n] says where the warp is on top.

    ``over`` is repeated to fill the tile (rows are weft threads, columns warp threads), so
    its sides must divide ``threads`` for the result to tile.
    """
    u, v = grid(size)
    x, y = u * threads, v * threads
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = 2 * (x - column) - 1, 2 * (y - row) - 1

    def on_top(dc: int, dr: int) -> Field:
        return over[(row + dr) % over.shape[0], (column + dc) % over.shape[1]].astype(float)

    warp = on_top(0, 0)
    # A float that spans several crossings sinks only at its two ends.
    ends_v = np.where(fy > 0, on_top(0, 1), on_top(0, -1))
    ends_u = np.where(fx > 0, 1 - on_top(1, 0), 1 - on_top(-1, 0))
    along = np.where(warp > 0, fy, fx)
    goes_on = np.where(warp > 0, ends_v, ends_u)
    across = np.where(warp > 0, fx, fy)
    sag = np.where(goes_on > 0, 1.0, np.sqrt(np.maximum(1 - 0.85 * along**2, 0)))
    height = sag * np.sqrt(np.maximum(1 - 0.9 * across**2, 0))
    random = np.random.default_rng(seed).random((2, threads))
    thread = np.where(warp > 0, random[0][column % threads], random[1][row % threads])
    return Weave(height, warp, across, thread)


def star_tiles(size: int, repeat: int) -> tuple[Field, Field]:
    """Eight-pointed stars and crosses, ``repeat`` of them across the tile.

    Returns ``(distance, kind)``: distance to the nearest seam in repeats, and 1 inside a
    star, 0 inside a cross. A star is the union of a square and that square turned by 45
    degrees, so its signed distance is the lesser of two box distances.
    """
    u, v = grid(size)
    x, y = (u * repeat) % 1 - 0.5, (v * repeat) % 1 - 0.5
    half = 0.5 / np.sqrt(2)
    upright = np.maximum(np.abs(x), np.abs(y)) - half
    turned = (np.abs(x) + np.abs(y)) / np.sqrt(2) - half
    signed = np.minimum(upright, turned)
    return np.abs(signed), (signed < 0).astype(float)


class Planks(NamedTuple):
    """Boards side by side; fields [size, size]."""

    board: Field
    """A random number in [0, 1) of the board."""
    seam: Field
    """Distance to the nearest seam, in widths of the tile."""
    shift: Field
    """The board's own random offset in [0, 1), to give each its own grain."""


def planks(size: int, boards: int, joints: int, seed: int) -> Planks:
    """``boards`` rows of boards along u, each row cut at ``joints`` staggered places."""
    u, v = grid(size)
    random = np.random.default_rng(seed)
    row = np.floor(v * boards).astype(int)
    start = random.random(boards)[row]
    along = (u + start) * joints
    piece = np.floor(along).astype(int) % joints
    numbers = random.random((2, boards, joints))
    across = (v * boards) % 1
    seam_v = np.minimum(across, 1 - across) / boards
    seam_u = np.minimum(along % 1, 1 - along % 1) / joints
    return Planks(numbers[0][row, piece], np.minimum(seam_u, seam_v), numbers[1][row, piece])


def box_distance(u: Field, v: Field, box: tuple[float, float, float, float], corner: float = 0):
    """Signed distance (negative inside) to a box ``(u0, v0, u1, v1)`` of rounded corners."""
    u0, v0, u1, v1 = box
    qx = np.abs(u - (u0 + u1) / 2) - (u1 - u0) / 2 + corner
    qy = np.abs(v - (v0 + v1) / 2) - (v1 - v0) / 2 + corner
    outside = np.hypot(np.maximum(qx, 0), np.maximum(qy, 0))
    return outside + np.minimum(np.maximum(qx, qy), 0) - corner


def panels(size: int, smallest: float, seed: int) -> tuple[Field, Field, list[tuple]]:
    """The tile split into rectangles again and again: ``(distance, number, boxes)``.

    ``distance`` to the nearest seam in tile widths, ``number`` a random value in [0, 1) of
    the panel, ``boxes`` their ``(u0, v0, u1, v1)``. No side becomes shorter than
    ``smallest``.
    """
    random = np.random.default_rng(seed)
    todo, boxes = [(0.0, 0.0, 1.0, 1.0)], []
    while todo:
        u0, v0, u1, v1 = todo.pop()
        wide, high = u1 - u0, v1 - v0
        if max(wide, high) < 2 * smallest or (max(wide, high) < 0.4 and random.random() < 0.25):
            boxes.append((u0, v0, u1, v1))
            continue
        # Seams on a grid of 1/32, so that they fall between texels.
        part = random.uniform(0.3, 0.7)
        if wide >= high:
            cut = round((u0 + part * wide) * 32) / 32
            todo += [(u0, v0, cut, v1), (cut, v0, u1, v1)]
        else:
            cut = round((v0 + part * high) * 32) / 32
            todo += [(u0, v0, u1, cut), (u0, cut, u1, v1)]
    u, v = grid(size)
    distance, number = np.zeros_like(u), np.zeros_like(u)
    for box in boxes:
        inside = (u >= box[0]) & (u < box[2]) & (v >= box[1]) & (v < box[3])
        distance[inside] = -box_distance(u, v, box)[inside]
        number[inside] = random.random()
    return distance, number, boxes


def rivets(size: int, centres: list[tuple[float, float]], radius: float) -> Field:
    """Dome height in [0, 1] of rivets of ``radius`` (tile widths) at ``centres``, [size, size]."""
    u, v = grid(size)
    height = np.zeros_like(u)
    for cu, cv in centres:
        du, dv = (u - cu + 0.5) % 1 - 0.5, (v - cv + 0.5) % 1 - 0.5
        height = np.maximum(height, np.sqrt(np.maximum(1 - (du**2 + dv**2) / radius**2, 0)))
    return height


def segment_distance(u: Field, v: Field, a: np.ndarray, b: np.ndarray) -> Field:
    """Distance to the segment from ``a`` [2] to ``b`` [2] and its copies in other tiles."""
    du, dv = (u - a[0] + 0.5) % 1 - 0.5, (v - a[1] + 0.5) % 1 - 0.5
    edge = b - a
    t = np.clip((du * edge[0] + dv * edge[1]) / (edge @ edge), 0, 1)
    return np.hypot(du - t * edge[0], dv - t * edge[1])


def scratches(
    size: int, count: int, length: tuple[float, float], width: float, spread: float, seed: int
) -> Field:
    """Straight scratches in [0, 1], [size, size].

    ``count`` segments of ``length`` (least, greatest; below half the tile) and ``width``, in
    tile widths, at angles to the u axis of deviation ``spread`` radians (inf: any angle).
    """
    u, v = grid(size)
    random = np.random.default_rng(seed)
    depth = np.zeros_like(u)
    for _ in range(count):
        centre = random.random(2)
        any_angle, near = random.uniform(0, np.pi), random.normal()
        angle = any_angle if np.isinf(spread) else spread * near
        half = random.uniform(*length) / 2 * np.array([np.cos(angle), np.sin(angle)])
        # From the centre both ways: the wrapped distance holds to half a tile from its start.
        distance = np.minimum(
            segment_distance(u, v, centre, centre + half),
            segment_distance(u, v, centre, centre - half),
        )
        deep = random.uniform(0.4, 1)
        depth = np.maximum(depth, deep * np.maximum(1 - distance / width, 0))
    return depth
