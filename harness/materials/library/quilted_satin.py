"""Quilted satin: padded diamonds and stitches, a broad highlight on strong curvature."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, fbm, grid
from harness.textures.sizes import SIZE

SUMMARY = "one broad highlight on a strong relief: quilted satin with stitched seams"


def bsdf() -> dict[str, Any]:
    """Pillows between diagonal seams; puckers run from each seam into its pillow."""
    u, v = grid(SIZE)
    n = 3
    p, q = n * (u + v), n * (u - v)
    to_p, to_q = np.abs(p - np.round(p)), np.abs(q - np.round(q))
    pillow = (np.abs(np.sin(np.pi * p)) * np.abs(np.sin(np.pi * q))) ** 0.45
    nearest_p = to_p < to_q
    seam = np.minimum(to_p, to_q)
    along = np.where(nearest_p, q, p)
    stitches = 8 * np.pi * along
    stitch = smoothstep(0.034, 0.018, seam) * smoothstep(0.1, 0.25, np.abs(np.sin(stitches)))
    pucker = np.cos(2 * stitches) * np.exp(-((seam / 0.12) ** 2)) * smoothstep(0, 0.05, seam)
    cloth = fbm(SIZE, (4, 4), seed=61, octaves=4)
    height = blur(pillow + 0.035 * pucker + 0.09 * stitch + 0.012 * cloth, 1.0)
    tone = unit_range(cloth) * 0.5 + 0.5 * pillow
    satin = ramp(tone, [(0, "#12304a"), (0.6, "#2b6a86"), (1, "#4d93a6")])
    thread = ramp(unit_range(cloth), [(0, "#cdbb90"), (1, "#e9dcb8")])
    return normal_map(
        height,
        0.055,
        {
            "type": "principled",
            "base_color": bitmap(mix(satin, thread, stitch)),
            "roughness": bitmap(mix(0.38, 0.75, stitch)),
            "specular": 0.7,
            "sheen": 0.5,
            "sheen_tint": 0.7,
        },
    )
