"""Environment maps: latitude-longitude radiance [H, W, 3], float32, y up.

Texel ``(i, j)`` is light from the direction ``(sin(phi) sin(theta), cos(theta),
-cos(phi) sin(theta))`` with ``theta = pi i / (H - 1)`` and ``phi = 2 pi (j + 1/2) / W``: the
first row is the zenith, the last the nadir. This is Mitsuba's ``envmap`` without a transform.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from harness.geometry.primitives import Array


def directions(height: int, width: int) -> NDArray[np.float64]:
    """Unit directions [H, W, 3] of the texels."""
    theta = np.pi * np.arange(height)[:, None] / (height - 1)
    phi = 2 * np.pi * (np.arange(width)[None] + 0.5) / width
    return np.stack(
        [
            np.sin(phi) * np.sin(theta),
            np.cos(theta) * np.ones_like(phi),
            -np.cos(phi) * np.sin(theta),
        ],
        -1,
    )


def softbox(
    d: NDArray[np.float64],
    azimuth: float,
    elevation: float,
    half_size: tuple[float, float],
    roll: float = 0.0,
    edge: float = 0.25,
) -> NDArray[np.float64]:
    """Coverage in [0, 1], [H, W], of a rectangular lamp as seen from the origin.

    Its middle is at ``azimuth`` (degrees from +z towards +x) and ``elevation`` (degrees above
    the horizon), ``half_size`` in units of its distance, turned by ``roll`` degrees; ``edge``
    is the part of the smaller half size over which it fades out.
    """
    a, e, r = np.deg2rad([azimuth, elevation, roll])
    middle = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    side = np.array([np.cos(a), 0.0, -np.sin(a)])
    top = np.cross(middle, side)
    side, top = np.cos(r) * side + np.sin(r) * top, np.cos(r) * top - np.sin(r) * side
    depth = d @ middle
    front = depth > 0
    # On the plane of the lamp; directions away from it never meet that plane.
    x = np.where(front, d @ side, 0) / np.where(front, depth, 1)
    y = np.where(front, d @ top, 0) / np.where(front, depth, 1)
    inside = np.minimum(half_size[0] - np.abs(x), half_size[1] - np.abs(y))
    t = np.clip(inside / (edge * min(half_size)), 0, 1)
    return np.where(front, t * t * (3 - 2 * t), 0)


def _dome(
    d: NDArray[np.float64], zenith: list[float], horizon: list[float], ground: list[float]
) -> NDArray[np.float64]:
    """Smooth background [H, W, 3]: ground below, horizon, zenith above."""
    y = d[..., 1:2]
    up = np.clip(y, 0, 1) ** 0.6
    sky = np.array(horizon) * (1 - up) + np.array(zenith) * up
    below = np.clip(-y / 0.35, 0, 1) ** 0.5
    return sky * (1 - below) + np.array(ground) * below


def studio(height: int = 128, width: int = 256) -> Array:
    """Photographer's studio: dim room, a key softbox, a cool strip, a warm rim, a small lamp."""
    d = directions(height, width)
    light = _dome(d, [0.32, 0.36, 0.42], [0.28, 0.27, 0.26], [0.10, 0.09, 0.08])
    lamps = [
        (softbox(d, -42, 42, (0.34, 0.34)), [15.0, 14.2, 13.0]),
        (softbox(d, 68, 12, (0.09, 0.75), roll=8), [15.0, 18.0, 22.0]),
        (softbox(d, 150, 38, (0.5, 0.2)), [16.0, 12.0, 8.0]),
        (softbox(d, 28, 62, (0.08, 0.08)), [46.0, 42.0, 36.0]),
    ]
    for cover, radiance in lamps:
        light = light * (1 - cover[..., None]) + cover[..., None] * np.array(radiance)
    return light.astype(np.float32)


def open_shade(height: int = 128, width: int = 256) -> Array:
    """Open shade: broad sky, a wide window, and a low, warm, hazy sun from the left."""
    d = directions(height, width)
    light = _dome(d, [0.55, 0.62, 0.72], [0.42, 0.42, 0.42], [0.12, 0.10, 0.08])
    low_sun = softbox(d, -68, 28, (0.26, 0.26), edge=1.0)
    window = softbox(d, 60, 35, (0.6, 0.45), edge=0.6)
    light = light + low_sun[..., None] * np.array([48.0, 40.0, 28.0])
    light = light + window[..., None] * np.array([0.8, 1.0, 1.3])
    return light.astype(np.float32)
