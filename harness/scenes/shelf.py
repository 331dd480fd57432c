"""A shelf of things, lit by lamps alone."""

from __future__ import annotations

from harness.geometry.primitives import Mesh, Sphere
from harness.geometry.solids import box, panel, ring, turned
from harness.scenes.base import AreaLamp, Camera, Scene
from harness.scenes.sizes import SCALE, Size
from harness.scenes.still_life import BOTTLE, BOWL, GOBLET, JAR, WALL, plain

PAINT = plain("paint", 0.30, 0.38, 0.40)

BOARD, DEEP, WIDE = 0.12, 1.5, 6.2
_FLOORS = (0.0, 1.9, 3.8)
"""Heights of the upper sides of the lower two boards, and of the top's lower side."""


def shelf(texture_repeat: float = 1.0, size: Size = "medium") -> Scene:
    """Shelf with vases, books, balls and a ring, under two lamps; no environment.

    The material under test is on the ball below, the bottle and the jar above.
    """
    d, k = SCALE[size], texture_repeat
    other = {"tested": False, "detail": d}
    low, high = _FLOORS[:2]
    objects: list[Mesh | Sphere] = [
        Sphere((-0.15, low + 0.72, 0.1), 0.72, (6.0 * k, 3.0 * k), rows=int(96 * d)),
        turned(_scaled(BOTTLE, 0.8), (-2.35, high, 0.1), repeat=0.9 * k, detail=d),
        turned(_scaled(JAR, 1.15), (1.95, high, 0.05), repeat=0.8 * k, detail=d),
        turned(_scaled(BOWL, 0.8), (-0.15, high, 0.1), material="brushed-metal", repeat=1.0,
               **other),
        turned(_scaled(GOBLET, 1.15), (-1.35, low, 0.35), material="molten-metal", repeat=1.5,
               **other),
        turned(_scaled(JAR, 1.0), (2.2, low, 0.1), material="star-tiles", repeat=0.8, **other),
        ring(0.42, 0.13, (1.15, low + 0.54, 0.25), tilt=78.0, repeat=1.5,
             material="tortoise-shell", **other),
        *_books(low, other),
    ]  # fmt: skip
    objects += [
        Sphere((x, high + y, z), 0.25, (4.0, 2.0), False, material, rows=int(48 * d))
        for x, y, z, material in (
            (-0.40, 0.62, 0.1, "elephant-hide"), (0.08, 0.60, 0.22, "tortoise-shell"),
            (-0.08, 0.66, -0.22, "suede"),
        )
    ]  # fmt: skip
    objects += _carcass(other)
    lamps = (
        AreaLamp((-3.4, 4.6, 6.4), (-0.2, 1.4, 0.0), (2.0, 1.6), (34.0, 30.0, 25.0)),
        AreaLamp((5.4, 2.8, 5.0), (0.4, 1.6, 0.0), (0.8, 2.8), (10.0, 13.0, 17.0)),
    )
    return Scene(
        "shelf",
        ("area-lights", "indirect: 4", "emitter-sampling"),
        tuple(objects),
        None,
        Camera((0.9, 2.9, 9.2), (0.0, 1.86, 0.0), fov=43.5, aspect=1.5, aperture=0.08, focus=9.2),
        "a shelf of things under two lamps",
        lamps,
    )


def _scaled(profile: tuple[tuple[float, float], ...], by: float) -> list[tuple[float, float]]:
    return [(by * r, by * y) for r, y in profile]


def _books(floor: float, other: dict) -> list[Mesh]:
    """Four upright, the last leaning on them."""
    standing = (
        (-2.78, 0.26, 1.30, 0.0, "saddle-leather"),
        (-2.49, 0.24, 1.45, 0.0, "suede"),
        (-2.22, 0.20, 1.22, 0.0, "quilted-satin"),
        (-1.93, 0.22, 1.28, 9.0, "elephant-hide"),
    )
    return [
        box((thick, tall, 0.95), (x, floor + tall / 2, 0.0), 0.03, lean=lean, repeat=0.9,
            material=material, **other)
        for x, thick, tall, lean, material in standing
    ]  # fmt: skip


def _carcass(other: dict) -> list[Mesh]:
    """Boards, sides and back of wood, before a wall."""
    top = _FLOORS[2]
    wood = {"edge": 0.02, "repeat": 0.45, "material": "wood-panel", **other}
    boards = [
        box((WIDE + 2 * BOARD, BOARD, DEEP), (0.0, y - BOARD / 2, 0.0), **wood)
        for y in (*_FLOORS[:2], top + BOARD)
    ]
    sides = [
        box((BOARD, top + BOARD, DEEP - 0.02), (x, top / 2, 0.0), **wood)
        for x in (-(WIDE + BOARD) / 2, (WIDE + BOARD) / 2)
    ]
    back = panel(
        (-WIDE / 2, -BOARD, -DEEP / 2), (WIDE, 0, 0), (0, top + BOARD, 0), 0.3,
        tested=False, material=PAINT,
    )  # fmt: skip
    wall = panel((-9, -4, -DEEP / 2 - 0.02), (18, 0, 0), (0, 12, 0), tested=False, material=WALL)
    return [*boards, *sides, back, wall]
