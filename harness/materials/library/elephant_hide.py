"""Coarse wrinkled hide: its normals swing far from the surface's own."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, cellular, fbm
from harness.textures.sizes import SIZE

SUMMARY = "strongly normal-mapped: coarse wrinkled hide with a satin highlight"


def bsdf() -> dict[str, Any]:
    """Domed plates of two sizes between deep wrinkles."""
    bend = 0.02 * fbm(SIZE, (3, 3), seed=31), 0.02 * fbm(SIZE, (3, 3), seed=32)
    plates = cellular(SIZE, (9, 7), seed=33, offset=bend)
    pebbles = cellular(SIZE, (24, 20), seed=34, offset=bend)
    dome = np.sqrt(smoothstep(0, 0.34, plates.border))
    small = smoothstep(0, 0.3, pebbles.border)
    height = blur(dome * (0.72 + 0.28 * small), 1.0)
    tone = unit_range(fbm(SIZE, (4, 4), seed=35) + 1.2 * (plates.value - 0.5))
    cavity = smoothstep(0.1, 0.8, height)
    colours = ramp(tone, [(0, "#4c463f"), (0.5, "#776c60"), (1, "#9a8c7b")])
    return normal_map(
        height,
        0.032,
        {
            "type": "principled",
            "base_color": bitmap(colours * mix(0.3, 1.0, cavity)[..., None]),
            "roughness": bitmap(mix(0.62, 0.38, cavity)),
            "specular": 0.6,
        },
    )
