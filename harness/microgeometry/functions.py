"""What a description can call: tileable fields and operations on them.

Every function takes the resolution first, which an expression leaves out. Lengths are in
widths of the tile whatever the resolution; ``du``, ``dv`` move the look-up by that much, which
bends a pattern and keeps it tileable. Whole numbers of cells, threads and boards fit the tile.
Fields are [size, size]; see :mod:`harness.materials.procedural` for the noise and patterns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from harness.microgeometry import patterns
from harness.microgeometry.patterns import Panels, Quilt, Scales, Stars
from harness.textures import maps as texture_maps
from harness.textures import noise as fields
from harness.textures import patterns as shapes
from harness.textures.noise import Cells, Field
from harness.textures.patterns import Planks, Weave

Number = Field | float


# --- noise and cells -------------------------------------------------------------------


def noise(
    size: int,
    cells_u: int,
    cells_v: int | None = None,
    *,
    seed: int,
    octaves: int = 4,
    gain: float = 0.5,
    ridged: int = 0,
    du: Number = 0.0,
    dv: Number = 0.0,
) -> Field:
    """Octaves of gradient noise, of mean 0 and deviation 1; ``ridged=1`` for thin crests."""
    period = _whole("cells", cells_u), _whole("cells", cells_u if cells_v is None else cells_v)
    return fields.fbm(size, period, seed, octaves, gain, (_full(size, du), _full(size, dv)), ridged)


def cells(
    size: int,
    cells_u: int,
    cells_v: int | None = None,
    *,
    seed: int,
    jitter: float = 1.0,
    du: Number = 0.0,
    dv: Number = 0.0,
) -> Cells:
    """Voronoi cells: ``.border`` and ``.nearest`` in widths of a cell, ``.value`` of the cell."""
    count = _whole("cells", cells_u), _whole("cells", cells_u if cells_v is None else cells_v)
    return fields.cellular(size, count, seed, jitter, (_full(size, du), _full(size, dv)))


def veins(
    size: int, cells_u: int, *, seed: int, width: float, du: Number = 0.0, dv: Number = 0.0
) -> Field:
    """Thin winding lines, 1 in the middle: where noise crosses zero, ``exp(-|noise| / width)``."""
    u, v = fields.grid(size)
    n = fields.gradient_noise(u + du, v + dv, (_whole("cells", cells_u),) * 2, seed)
    return np.exp(-np.abs(n) / width)


# --- man-made patterns -----------------------------------------------------------------


def weave(size: int, threads: int, pattern: str = "plain", *, seed: int) -> Weave:
    """Threads: ``.height``, ``.warp`` (1 where it is on top), ``.across``, ``.thread``."""
    over = patterns.weave_pattern(pattern, _whole("threads", threads))
    return shapes.weave(size, over, threads, seed)


def planks(size: int, boards: int, joints: int = 1, *, seed: int) -> Planks:
    """Boards along u: ``.seam`` (distance to it), ``.board`` and ``.shift``, random numbers."""
    return shapes.planks(size, _whole("boards", boards), _whole("joints", joints), seed)


def scales(size: int, across: int, down: int, *, seed: int) -> Scales:
    """Rows of round scales, each over the next: ``.height``, ``.rim``, ``.value``, ..."""
    return patterns.scales(size, _whole("across", across), _whole("down", down), seed)


def stars(size: int, repeat: int) -> Stars:
    """Eight-pointed stars and crosses: ``.seam`` in repeats, ``.star`` 1 in a star."""
    return Stars(*shapes.star_tiles(size, _whole("repeat", repeat)))


def panels(size: int, smallest: float, *, seed: int) -> Panels:
    """Rectangles: ``.seam`` in widths of the tile, ``.value`` of the panel, ``.rivets``."""
    return patterns.panels(size, smallest, seed)


def quilt(size: int, repeat: int, stitches: int = 8) -> Quilt:
    """Diamonds sewn down along their edges: ``.seam``, ``.dome``, ``.button``, ``.thread``."""
    return patterns.quilt(size, _whole("repeat", repeat), _whole("stitches", stitches))


def grooves(
    size: int, count: int, along: str = "u", *, du: Number = 0.0, dv: Number = 0.0
) -> Field:
    """``count`` round grooves, ``(1 + cos) / 2``, that run along u or v."""
    if along not in ("u", "v"):
        raise ValueError(f"grooves(): along: expected 'u' or 'v', got {along!r}")
    u, v = fields.grid(size)
    at = v + dv if along == "u" else u + du
    return 0.5 + 0.5 * np.cos(2 * np.pi * _whole("count", count) * at)


def scratches(
    size: int, count: int, *, length: float, width: float, spread: float = np.inf, seed: int
) -> Field:
    """Straight scratches of depth 0.4 to 1, of half to the full ``length`` (below 0.5)."""
    return shapes.scratches(size, _whole("count", count), (length / 2, length), width, spread, seed)


def motif(size: int, shape: str, repeat: int, *, du: Number = 0.0, dv: Number = 0.0) -> Field:
    """Signed distance, in repeats, to a shape in each of ``repeat``^2 squares; inside below 0."""
    return patterns.motif(size, shape, _whole("repeat", repeat), du, dv)


# --- coordinates and operations --------------------------------------------------------


def u(size: int) -> Field:
    """The coordinate u of each texel's centre."""
    return fields.grid(size)[0]


def v(size: int) -> Field:
    """The coordinate v of each texel's centre."""
    return fields.grid(size)[1]


def step(size: int, x: Number, low: float, high: float) -> Number:
    """Smooth step from 0 at ``low`` to 1 at ``high``, which may be the smaller."""
    if low == high:
        raise ValueError("step(): expected two different ends")
    return texture_maps.smoothstep(low, high, x)


def unit(size: int, x: Field) -> Field:
    """``x`` moved and scaled to span [0, 1]."""
    if np.ndim(x) == 0 or np.ptp(x) == 0:
        raise ValueError("unit(): expected a field that varies")
    return texture_maps.unit_range(x)


def mix(size: int, a: Number, b: Number, t: Number) -> Number:
    """``a`` where ``t`` is 0, ``b`` where it is 1."""
    return a * (1 - t) + b * t


def blur(size: int, x: Field, width: float, width_v: float | None = None) -> Field:
    """Gaussian blur of deviation ``width`` (along u, and along v if that is another)."""
    return fields.blur(x, (width * size, (width if width_v is None else width_v) * size))


def warp(size: int, x: Field, du: Number, dv: Number) -> Field:
    """``x`` looked up at (u + du, v + dv)."""
    return fields.warped(x, _full(size, du), _full(size, dv))


def slope_angle(size: int, x: Field) -> Field:
    """Direction, in radians from u, of the lines along which ``x`` is constant."""
    du = np.roll(x, -1, 1) - np.roll(x, 1, 1)
    dv = np.roll(x, -1, 0) - np.roll(x, 1, 0)
    return np.arctan2(du, -dv)


def minimum(size: int, a: Number, b: Number) -> Number:
    """The lesser of two."""
    return np.minimum(a, b)


def maximum(size: int, a: Number, b: Number) -> Number:
    """The greater of two."""
    return np.maximum(a, b)


def clip(size: int, x: Number, low: float = 0.0, high: float = 1.0) -> Number:
    """``x``, held between ``low`` and ``high``."""
    return np.clip(x, low, high)


def sqrt(size: int, x: Number) -> Number:
    """Square root."""
    return np.sqrt(x)


def exp(size: int, x: Number) -> Number:
    """Exponential."""
    return np.exp(x)


def cos(size: int, x: Number) -> Number:
    """Cosine of radians."""
    return np.cos(x)


def sin(size: int, x: Number) -> Number:
    """Sine of radians."""
    return np.sin(x)


def abs(size: int, x: Number) -> Number:
    """Absolute value."""
    return np.abs(x)


def floor(size: int, x: Number) -> Number:
    """The whole number below."""
    return np.floor(x)


def _whole(what: str, value: Any) -> int:
    if not isinstance(value, int) or value < 1:
        raise ValueError(f"{what}: expected a whole number of at least 1, got {value!r}")
    return value


def _full(size: int, value: Number) -> Field:
    return np.broadcast_to(np.asarray(value, float), (size, size))


FUNCTIONS: dict[str, Callable[..., Any]] = {
    f.__name__: f
    for f in (
        *(noise, cells, veins),
        *(weave, planks, scales, stars, panels, quilt, grooves, scratches, motif),
        *(u, v, step, unit, mix, blur, warp, slope_angle, minimum, maximum, clip),
        *(sqrt, exp, cos, sin, abs, floor),
    )
}
"""By the name that an expression uses."""
