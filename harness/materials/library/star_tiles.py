"""Glazed star-and-cross tiles: glossy glaze, matt grout, a mask between them."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, colour, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, cellular, fbm
from harness.textures.patterns import star_tiles
from harness.textures.sizes import SIZE

SUMMARY = "spatially varying mixture: glossy glazed star tiles in matt grout"


def bsdf() -> dict[str, Any]:
    """A blend of rough grout and glaze; the glaze pools, crazes and bulges."""
    distance, star = star_tiles(SIZE, 2)
    tile = smoothstep(0.016, 0.028, distance)
    pool = unit_range(fbm(SIZE, (5, 5), seed=41, octaves=4))
    cracks = cellular(SIZE, (13, 13), seed=42).border
    crazing = 1 - smoothstep(0.0, 0.05, cracks)
    rosette = smoothstep(0.02, 0.03, np.abs(distance - 0.075)) * (1 - star) + star
    stars = ramp(pool, [(0, "#04304f"), (0.5, "#0b6a93"), (1, "#2fb0bd")])
    crosses = ramp(pool, [(0, "#c9a25a"), (0.5, "#e6d3a8"), (1, "#f2e8cf")])
    crosses = mix(colour("#8c2f1c"), crosses, rosette)
    glaze = mix(crosses, stars, star) * (1 - 0.35 * crazing)[..., None]
    sand = unit_range(fbm(SIZE, (40, 40), seed=43))
    grout = colour("#857b6e").tolist()
    dome = np.sqrt(smoothstep(0.01, 0.16, distance))
    height = blur(tile * (0.6 + 0.4 * dome) + 0.02 * pool + 0.06 * (1 - tile) * sand, 0.8)
    return normal_map(
        height,
        0.016,
        {
            "type": "blendbsdf",
            "weight": bitmap(tile),
            "grout": {"type": "diffuse", "reflectance": {"type": "rgb", "value": grout}},
            "glaze": {
                "type": "principled",
                "base_color": bitmap(glaze),
                "roughness": bitmap(0.26 + 0.1 * pool),
                "specular": 0.75,
            },
        },
    )
