"""Smooth saddle leather: a single isotropic highlight over fine grain and creases."""

from __future__ import annotations

from typing import Any

from harness.textures.maps import bitmap, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, cellular, fbm
from harness.textures.sizes import SIZE

SUMMARY = "one isotropic highlight: polished saddle leather with fine grain"


def bsdf() -> dict[str, Any]:
    """Plastic-like highlight; creases are darker and rougher."""
    bend = 0.012 * fbm(SIZE, (4, 4), seed=21), 0.012 * fbm(SIZE, (4, 4), seed=22)
    grain = smoothstep(0, 0.2, cellular(SIZE, (34, 34), seed=23, offset=bend).border)
    creases = smoothstep(0, 0.09, cellular(SIZE, (5, 4), seed=24, offset=bend).border)
    tone = unit_range(fbm(SIZE, (3, 3), seed=25, octaves=5))
    height = blur(0.22 * grain + 0.6 * creases, 0.9)
    shade = (0.3 + 0.7 * tone) * (0.72 + 0.14 * grain + 0.14 * creases)
    return normal_map(
        height,
        0.006,
        {
            "type": "principled",
            "base_color": bitmap(
                ramp(shade, [(0, "#2a0f06"), (0.45, "#8a3c14"), (0.75, "#b8632a"), (1, "#d08a4a")])
            ),
            "roughness": bitmap(mix(0.42, 0.3, grain * creases)),
            "specular": 0.5,
        },
    )
