"""Half and difference vectors of two directions (Rusinkiewicz 1998), over columns."""

from __future__ import annotations

from typing import Any

import drjit as dr

from harness.core.columns.bridge import Columns, Float

Vector = tuple[Float, Float, Float]


def direction(x: Float, y: Float) -> tuple[Vector, Any]:
    """The unit vector above a point of the projected disk, and whether there is one."""
    cos_squared = 1 - x * x - y * y
    inside = cos_squared > 0
    return (x, y, dr.sqrt(dr.select(inside, cos_squared, 1))), inside


def half_and_difference(first: Vector, second: Vector) -> tuple[Columns, Vector]:
    r"""``(h, d)``: the half vector, and ``first`` in the frame that has h as its pole.

    .. math:: h = \frac{a + b}{|a + b|}, \qquad d = R_y(-\theta_h)\,R_z(-\phi_h)\,a

    Both directions lie above the plane, so a + b is never zero. d of the other direction is
    (-d.x, -d.y, d.z).
    """
    x, y, z = (a + b for a, b in zip(first, second, strict=True))
    scale = dr.rsqrt(x * x + y * y + z * z)
    h = [x * scale, y * scale, z * scale]
    sin = dr.sqrt(h[0] * h[0] + h[1] * h[1])
    # At the pole the azimuth has no value; any one gives a frame.
    pole = sin == 0
    safe = dr.select(pole, 1, sin)
    cos_phi, sin_phi = dr.select(pole, 1, h[0] / safe), dr.select(pole, 0, h[1] / safe)
    u = first[0] * cos_phi + first[1] * sin_phi
    v = first[1] * cos_phi - first[0] * sin_phi
    return h, (u * h[2] - first[2] * sin, v, u * sin + first[2] * h[2])
