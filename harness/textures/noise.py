"""Tileable noise: gradient noise and its octaves, cells, blurring and warping."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]


def grid(size: int) -> tuple[Field, Field]:
    """Texel centres ``(u, v)`` in [0, 1), each [size, size]."""
    centres = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(centres, centres)
    return u, v


def gradient_noise(u: Field, v: Field, period: tuple[int, int], seed: int) -> Field:
    """Gradient noise at ``(u, v)``, of period 1 in both, in about [-0.7, 0.7].

    ``period`` is the number of lattice cells across the tile, (along u, along v). After
    Perlin (1985), with the quintic fade of Perlin (2002) and unit gradients on a lattice
    that wraps around.
    """
    across, down = period
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, (down, across))
    x, y = u * across, v * down
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0

    def corner(dx: int, dy: int) -> Field:
        a = angle[(y0 + dy) % down, (x0 + dx) % across]
        return np.cos(a) * (fx - dx) + np.sin(a) * (fy - dy)

    def fade(t: Field) -> Field:
        return t**3 * (t * (6 * t - 15) + 10)

    sx, sy = fade(fx), fade(fy)
    top = corner(0, 0) * (1 - sx) + corner(1, 0) * sx
    bottom = corner(0, 1) * (1 - sx) + corner(1, 1) * sx
    return top * (1 - sy) + bottom * sy


def fbm(
    size: int,
    period: tuple[int, int],
    seed: int,
    octaves: int = 4,
    gain: float = 0.5,
    offset: tuple[Field, Field] | None = None,
    ridged: bool = False,
) -> Field:
    """Sum of octaves of gradient noise, [size, size], zero mean and unit deviation.

    Octave ``k`` has ``period * 2**k`` cells and weight ``gain**k``; ``ridged`` folds each
    octave to ``1 - |noise|``, whose crests are thin. ``offset`` moves the points (in uv)
    before the look-up, which bends the pattern and keeps it tileable.
    """
    u, v = grid(size)
    if offset is not None:
        u, v = u + offset[0], v + offset[1]
    total = np.zeros_like(u)
    for k in range(octaves):
        octave = gradient_noise(u, v, (period[0] << k, period[1] << k), seed + 7919 * k)
        total += gain**k * (1 - np.abs(octave) if ridged else octave)
    return (total - total.mean()) / total.std()


class Cells(NamedTuple):
    """Voronoi cells, each field [size, size]; distances in widths of a lattice cell."""

    nearest: Field
    """Distance to the nearest seed."""
    border: Field
    """Distance to the nearest edge between two cells; zero on the edge."""
    value: Field
    """A random number in [0, 1) of the cell."""


def cellular(
    size: int,
    cells: tuple[int, int],
    seed: int,
    jitter: float = 1.0,
    offset: tuple[Field, Field] | None = None,
) -> Cells:
    """Voronoi cells around one jittered seed in each of ``cells`` (along u, along v).

    After Worley (1996); the border distance is exact: over the two seeds' bisectors,
    ``dot((a + b) / 2, (b - a) / |b - a|)`` for seeds relative to the point.
    """
    u, v = grid(size)
    if offset is not None:
        u, v = u + offset[0], v + offset[1]
    across, down = cells
    random = np.random.default_rng(seed)
    shift = 0.5 + jitter * (random.random((2, down, across)) - 0.5)
    numbers = random.random((down, across))
    x, y = u * across, v * down
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)

    # Two rings of neighbours: with full jitter an edge may belong to a seed two cells off.
    steps = [(dx, dy) for dy in range(-2, 3) for dx in range(-2, 3)]
    to_x, to_y, number = [], [], []
    for dx, dy in steps:
        column, row = (x0 + dx) % across, (y0 + dy) % down
        to_x.append(x0 + dx + shift[0, row, column] - x)
        to_y.append(y0 + dy + shift[1, row, column] - y)
        number.append(numbers[row, column])
    px, py, pv = np.stack(to_x), np.stack(to_y), np.stack(number)
    distance = np.hypot(px, py)
    first = distance.argmin(0)[None]

    ax, ay = np.take_along_axis(px, first, 0), np.take_along_axis(py, first, 0)
    ex, ey = px - ax, py - ay
    length = np.hypot(ex, ey)
    same = length == 0  # the nearest seed itself has no bisector
    ratio = ((px + ax) * ex + (py + ay) * ey) / (2 * np.where(same, 1, length))
    border = np.where(same, np.inf, ratio).min(0)
    return Cells(
        np.take_along_axis(distance, first, 0)[0], border, np.take_along_axis(pv, first, 0)[0]
    )


def sample(field: Field, u: Field, v: Field) -> Field:
    """Bilinear look-up of ``field`` [size, size] at ``(u, v)``, wrapping around."""
    size = field.shape[0]
    x, y = u * size - 0.5, v * size - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    a, b = x0 % size, (x0 + 1) % size
    c, d = y0 % size, (y0 + 1) % size
    top = field[c, a] * (1 - fx) + field[c, b] * fx
    bottom = field[d, a] * (1 - fx) + field[d, b] * fx
    return top * (1 - fy) + bottom * fy


def warped(field: Field, du: Field, dv: Field) -> Field:
    """``field`` looked up at ``(u + du, v + dv)``."""
    u, v = grid(field.shape[0])
    return sample(field, u + du, v + dv)


def blur(field: Field, sigma: float | tuple[float, float]) -> Field:
    """Gaussian blur with wrap-around; ``sigma`` in texels (both, or along u and along v)."""
    sigma_u, sigma_v = (sigma, sigma) if np.isscalar(sigma) else sigma
    size = field.shape[0]
    f = np.fft.fftfreq(size)
    kernel = np.exp(-2 * np.pi**2 * ((sigma_u * f[None, :]) ** 2 + (sigma_v * f[:, None]) ** 2))
    return np.fft.ifft2(np.fft.fft2(field) * kernel).real
