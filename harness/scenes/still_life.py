"""A still life on a table, after Figure 11 of Xu et al. (2023, NeuSample)."""

from __future__ import annotations

import numpy as np

from harness.geometry.primitives import Mesh, Sphere
from harness.geometry.solids import box, panel, runner, turned
from harness.scenes.base import AreaLamp, Camera, Scene
from harness.scenes.environment import open_shade
from harness.scenes.sizes import SCALE, Size

BOTTLE = (
    (0.0, 0.0), (0.36, 0.0), (0.43, 0.03), (0.45, 0.3), (0.45, 0.95), (0.40, 1.2), (0.22, 1.42),
    (0.15, 1.6), (0.145, 1.9), (0.19, 1.95), (0.19, 2.03), (0.14, 2.05), (0.0, 2.05),
)  # fmt: skip
BOWL = (
    (0.0, 0.0), (0.34, 0.0), (0.38, 0.05), (0.36, 0.12), (0.62, 0.26), (0.88, 0.55), (0.97, 0.72),
    (0.96, 0.76), (0.91, 0.72), (0.82, 0.56), (0.58, 0.32), (0.3, 0.2), (0.0, 0.18),
)  # fmt: skip
GOBLET = (
    (0.0, 0.0), (0.30, 0.0), (0.31, 0.03), (0.12, 0.08), (0.06, 0.18), (0.06, 0.40), (0.10, 0.48),
    (0.27, 0.60), (0.33, 0.82), (0.30, 1.08), (0.28, 1.08), (0.30, 0.82), (0.24, 0.64), (0.0, 0.54),
)  # fmt: skip
JAR = (
    (0.0, 0.0), (0.30, 0.0), (0.38, 0.04), (0.56, 0.30), (0.62, 0.58), (0.54, 0.86), (0.36, 1.02),
    (0.34, 1.10), (0.40, 1.15), (0.38, 1.18), (0.30, 1.12), (0.0, 1.10),
)  # fmt: skip


def plain(name: str, *rgb: float) -> dict:
    """Specification of a Lambertian material of one colour."""
    value = {"type": "rgb", "value": list(rgb)}
    return {"name": name, "type": "mitsuba", "bsdf": {"type": "diffuse", "reflectance": value}}


WALL, FLOOR = plain("wall", 0.42, 0.40, 0.37), plain("floor", 0.16, 0.13, 0.11)


def table_still_life(texture_repeat: float = 1.0, size: Size = "medium") -> Scene:
    """Still life on a table, by a window: several materials, bounced light, two lamps.

    The material under test is on the runner and on the bottle.
    """
    d, k = SCALE[size], texture_repeat
    around = {"tested": False, "detail": d}
    objects: list[Mesh | Sphere] = [
        runner(2.3, -1.7, 1.62, 1.15, (-0.55, 0.0, 0.0), repeat=0.8 * k, detail=d),
        turned(BOTTLE, (-0.95, 0.02, -0.35), repeat=0.8 * k, detail=d),
        turned(BOWL, (0.95, 0.0, 0.15), repeat=1.0, material="brushed-metal", **around),
        turned(GOBLET, (-2.15, 0.02, 0.25), repeat=1.5, material="molten-metal", **around),
        turned(JAR, (2.35, 0.0, -0.75), repeat=0.8, material="star-tiles", **around),
        box((1.25, 0.2, 0.9), (-2.3, 0.1, -0.85), 0.04, 18.0, repeat=0.9,
            material="saddle-leather", **around),
        box((1.1, 0.16, 0.8), (-2.25, 0.28, -0.85), 0.04, -6.0, repeat=0.9,
            material="quilted-satin", **around),
        box((7.2, 0.26, 3.6), (0.0, -0.13, -0.1), 0.06, repeat=0.45,
            material="wood-panel", **around),
        *(box((0.3, 2.6, 0.3), (x, -1.5, z), 0.05, repeat=0.45, material="wood-panel", **around)
          for x in (-3.2, 3.2) for z in (-1.6, 1.4)),
    ]  # fmt: skip
    fruits = (
        ((0.72, 0.62, 0.22), 0.34, "elephant-hide"),
        ((1.28, 0.63, 0.02), 0.33, "suede"),
        ((1.02, 0.68, 0.55), 0.31, "tortoise-shell"),
        ((1.02, 1.06, 0.22), 0.29, "tortoise-shell"),
        ((0.36, 0.30, 1.22), 0.30, "tortoise-shell"),
        ((2.05, 0.27, 0.85), 0.27, "elephant-hide"),
    )
    objects += [
        Sphere(center, radius, (4.0, 2.0), False, material, rows=int(48 * d))
        for center, radius, material in fruits
    ]
    room = {"tested": False}
    objects += [
        panel((-7.0, -2.8, -3.4), (14.0, 0, 0), (0, 9.0, 0), material=WALL, **room),
        panel((-7.0, -2.8, 6.5), (14.0, 0, 0), (0, 0, -9.9), material=FLOOR, **room),
        panel((7.0, -2.8, -3.4), (0, 0, 9.9), (0, 9.0, 0), material=WALL, **room),
    ]
    lamps = (
        AreaLamp((-5.2, 3.9, 2.4), (0.0, 0.4, 0.0), (2.6, 3.2), (11.0, 12.0, 13.5)),
        AreaLamp((3.4, 4.6, -0.6), (0.8, 0.0, 0.1), (0.7, 0.7), (46.0, 34.0, 20.0)),
    )
    return Scene(
        "table-still-life",
        ("environment", "area-lights", "indirect: 12", "emitter-sampling"),
        tuple(objects),
        (0.25 * open_shade(int(128 * d), int(256 * d))).astype(np.float32),
        Camera(
            (0.35, 2.75, 7.4), (0.05, 0.42, 0.0), fov=43.0, aspect=1.5, aperture=0.07, focus=7.6
        ),
        "a still life on a table by a window",
        lamps,
    )
