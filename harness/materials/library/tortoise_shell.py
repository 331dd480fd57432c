"""Tortoise shell: mottled plates with growth rings under a clear coat."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, cellular, fbm
from harness.textures.sizes import SIZE

SUMMARY = "layered coat on relief: tortoise shell, anisotropic body under a clear coat"


def bsdf() -> dict[str, Any]:
    """Rays of dark pigment from the middle of each plate; rings along its rim."""
    bend = 0.01 * fbm(SIZE, (4, 4), seed=91), 0.01 * fbm(SIZE, (4, 4), seed=92)
    plate = cellular(SIZE, (4, 4), seed=93, jitter=0.55, offset=bend)
    mottle = fbm(SIZE, (6, 6), seed=94, octaves=5, gain=0.6)
    rings = 0.5 + 0.5 * np.cos(2 * np.pi * 13 * plate.border + 0.5 * mottle)
    seam = smoothstep(0.0, 0.06, plate.border)
    dome = np.sqrt(smoothstep(0, 0.5, plate.border))
    dark = unit_range(0.8 * mottle - 2.6 * plate.border + 1.1 * rings * (plate.border < 0.4))
    shell = ramp(
        dark,
        [(0, "#f0b95a"), (0.3, "#d08a2c"), (0.55, "#7c3d12"), (0.75, "#34170a"), (1, "#1a0d07")],
    )
    height = blur(seam * (0.55 + 0.4 * dome) + 0.045 * rings * seam, 1.0)
    return normal_map(
        height,
        0.022,
        {
            "type": "principled",
            "base_color": bitmap(shell * mix(0.35, 1.0, seam)[..., None]),
            "roughness": bitmap(mix(0.7, mix(0.3, 0.44, unit_range(mottle)), seam)),
            "specular": 0.7,
            "anisotropic": 0.6,
            "clearcoat": bitmap(seam),
            "clearcoat_gloss": 0.3,
        },
    )
