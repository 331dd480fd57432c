"""Patterns that only descriptions use: scales, quilting, motifs, weaves by name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from harness.core.protocol.errors import nearest
from harness.textures.noise import Field, grid
from harness.textures.patterns import box_distance, rivets
from harness.textures.patterns import panels as split

WEAVES: dict[str, np.ndarray] = {
    "plain": np.array([[1, 0], [0, 1]]),
    "basket": np.kron(np.array([[1, 0], [0, 1]]), np.ones((2, 2), int)),
    "twill": np.array([[(i + j) % 4 < 2 for j in range(4)] for i in range(4)]).astype(int),
    "satin": np.array([[(3 * i + j) % 8 != 0 for j in range(8)] for i in range(8)]).astype(int),
}
"""Where the warp is on top, by name of the weave."""


def weave_pattern(name: str, threads: int) -> np.ndarray:
    """The named weave, whose side must divide the number of threads."""
    if name not in WEAVES:
        raise ValueError(f"weave(): unknown pattern {name!r}{nearest(str(name), WEAVES)}")
    over = WEAVES[name]
    if threads % len(over):
        raise ValueError(f"weave(): {name}: expected a multiple of {len(over)} threads")
    return over


class Stars(NamedTuple):
    """Star-and-cross tiling; fields [size, size]."""

    seam: Field
    """Distance to the nearest seam, in repeats."""
    star: Field
    """1 inside a star, 0 inside a cross."""


class Scales(NamedTuple):
    """Overlapping scales; fields [size, size]."""

    height: Field
    """From 0 where a scale goes under its neighbours to 1 at its free rim."""
    rim: Field
    """Distance from the free rim, in widths of a scale."""
    value: Field
    """A random number in [0, 1) of the scale."""
    across: Field
    """Position across the scale, in [-1, 1]."""


def scales(size: int, across: int, down: int, seed: int) -> Scales:
    """Scales of radius one spacing, in rows shifted by half; the rims point to -v.

    ``down`` must be even for the shift to tile.
    """
    if down % 2:
        raise ValueError("scales(): down: expected an even number")
    u, v = grid(size)
    x, y = u * across, v * down
    numbers = np.random.default_rng(seed).random((down, across))
    row0 = np.floor(y).astype(int)
    done = np.zeros((size, size), bool)
    height, rim, value, side = (np.zeros((size, size)) for _ in range(4))
    # A scale hangs from its own row down over the rows below: the highest row comes last, so
    # the first scale found from below, whose disk covers the point, is the one on top.
    for up in (0, 1, 2):
        row = row0 + up
        shift = 0.5 * (row % 2)
        column = np.floor(x - shift).astype(int)
        fx = x - shift - column - 0.5
        fy = y - row - 1
        # An ellipse that hangs from the top of its row and covers half of its neighbours.
        radius = np.hypot(fx / 0.62, fy / 1.9)
        inside = (radius < 1) & ~done
        numbers_here = numbers[row % down, column % across]
        height = np.where(inside, radius**2, height)
        rim = np.where(inside, (1 - radius) * 0.62, rim)
        value = np.where(inside, numbers_here, value)
        side = np.where(inside, fx / 0.62, side)
        done |= inside
    return Scales(height, rim, value, side)


class Panels(NamedTuple):
    """Rectangular panels; fields [size, size]."""

    seam: Field
    """Distance to the nearest seam, in widths of the tile."""
    value: Field
    """A random number in [0, 1) of the panel."""
    rivets: Field
    """Height in [0, 1] of round heads near the corners of the larger panels."""
    slots: Field
    """1 in the louvres of every third of the larger panels, with soft edges."""


def panels(size: int, smallest: float, seed: int) -> Panels:
    """The tile split into rectangles, no side shorter than ``smallest``."""
    seam, value, boxes = split(size, smallest, seed)
    inset, radius = 0.19 * smallest, 0.08 * smallest
    large = [b for b in boxes if min(b[2] - b[0], b[3] - b[1]) > 1.2 * smallest]
    corners = [
        (cu, cv)
        for u0, v0, u1, v1 in large
        for cu in (u0 + inset, u1 - inset)
        for cv in (v0 + inset, v1 - inset)
    ]
    u, v = grid(size)
    slots = np.zeros_like(u)
    for u0, v0, u1, v1 in large[::3]:
        border = 0.36 * smallest
        box = box_distance(u, v, (u0 + border, v0 + border, u1 - border, v1 - border))
        count = max(1, round((v1 - v0 - 2 * border) / (0.18 * smallest)))
        wave = -np.cos(2 * np.pi * count * (v - v0 - border) / (v1 - v0 - 2 * border))
        slots = np.maximum(slots, (box < 0) * np.clip(wave, 0, 1))
    return Panels(seam, value, rivets(size, corners, radius), slots)


class Quilt(NamedTuple):
    """Diamond quilting; fields [size, size]."""

    seam: Field
    """Distance to the nearest seam, in repeats."""
    dome: Field
    """Height of the filling, 0 along seams to 1 in the middle of a diamond."""
    button: Field
    """Distance to the nearest crossing of two seams, in repeats."""
    thread: Field
    """1 on the middle of a stitch, 0 between stitches and off the seam's line."""


def quilt(size: int, repeat: int, stitches: int) -> Quilt:
    """Seams along both diagonals of ``repeat``^2 squares, ``stitches`` to a side of a diamond."""
    u, v = grid(size)
    a, b = repeat * (u + v), repeat * (u - v)
    fa, fb = a - np.floor(a) - 0.5, b - np.floor(b) - 0.5
    to_a, to_b = (0.5 - np.abs(fa)) / np.sqrt(2), (0.5 - np.abs(fb)) / np.sqrt(2)
    seam = np.minimum(to_a, to_b)
    button = np.hypot(to_a, to_b)
    dome = np.cos(np.pi * fa) * np.cos(np.pi * fb)
    along = np.where(to_a < to_b, fb, fa)
    stitch = np.clip(0.5 + np.cos(2 * np.pi * stitches * along), 0, 1)
    return Quilt(seam, dome, button, stitch * np.exp(-((seam / 0.012) ** 2)))


def motif(size: int, shape: str, repeat: int, du: Field | float, dv: Field | float) -> Field:
    """Signed distance (about; negative inside) to a shape in the middle of each square."""
    if shape not in MOTIFS:
        raise ValueError(f"motif(): unknown shape {shape!r}{nearest(str(shape), MOTIFS)}")
    u, v = grid(size)
    x, y = ((u + du) * repeat) % 1 - 0.5, ((v + dv) * repeat) % 1 - 0.5
    return MOTIFS[shape](x, y)


def _petals(x: Field, y: Field, count: int, inner: float, outer: float) -> Field:
    """A rosette between two radii: the outline r(angle) of ``count`` round petals."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    outline = inner + (outer - inner) * np.abs(np.cos(count * angle / 2)) ** 0.7
    return radius - outline


def _lotus(x: Field, y: Field) -> Field:
    """An open flower from the side: five pointed petals on a low arc, and its stalk."""
    distance = np.full_like(x, np.inf)
    for angle in (-1.15, -0.6, 0.0, 0.6, 1.15):
        s, c = np.sin(angle), np.cos(angle)
        along = s * x + c * (y + 0.22)
        side = c * x - s * (y + 0.22)
        width = 0.085 * np.sin(np.pi * np.clip(along / 0.52, 0, 1)) ** 0.75
        inside = np.abs(side) - width
        ends = np.maximum(-along, along - 0.52)
        distance = np.minimum(distance, np.maximum(inside, ends))
    stalk = np.maximum(np.abs(x) - 0.02, np.maximum(y + 0.2, -0.5 - y))
    return np.minimum(distance, stalk)


MOTIFS = {
    "disk": lambda x, y: np.hypot(x, y) - 0.3,
    "diamond": lambda x, y: (np.abs(x) + np.abs(y) - 0.4) / np.sqrt(2),
    "square": lambda x, y: np.maximum(np.abs(x), np.abs(y)) - 0.32,
    "clover": lambda x, y: _petals(x, y, 4, 0.1, 0.36),
    "rosette": lambda x, y: _petals(x, y, 8, 0.24, 0.4),
    "lotus": _lotus,
}
"""Outlines within [-1/2, 1/2]^2, by name."""
