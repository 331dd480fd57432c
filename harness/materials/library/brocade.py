"""Brocade: silk warp and metallic weft, each with its own anisotropic lobe."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, colour, mix, normal_map, smoothstep
from harness.textures.noise import blur, grid
from harness.textures.patterns import weave
from harness.textures.sizes import SIZE

SUMMARY = "several lobes: brocade of silk warp and gilt weft, crossed anisotropic lobes"

THREADS = 64


def _motif() -> np.ndarray:
    """Where the warp floats on top, [THREADS, THREADS]: satin ground, ogival flowers."""
    u, v = grid(THREADS)
    flowers = np.zeros_like(u)
    for cu, cv in ((0.0, 0.0), (0.5, 0.5)):
        du, dv = (u - cu + 0.5) % 1 - 0.5, (v - cv + 0.5) % 1 - 0.5
        radius, angle = np.hypot(du, dv), np.arctan2(dv, du)
        petals = 0.15 + 0.055 * np.cos(8 * angle)
        ring = np.abs(np.abs(du) ** 0.9 + np.abs(dv) ** 1.1 - 0.44)
        flowers = np.maximum(flowers, ((radius < petals) & (radius > 0.05)) | (ring < 0.022))
    row, column = np.indices(u.shape)
    satin = (column + 3 * row) % 8 != 0
    twill = (column + row) % 4 == 0
    return np.where(flowers > 0, twill, satin)


def bsdf() -> dict[str, Any]:
    """A blend, thread by thread, of silk (highlight across v) and gilt (across u)."""
    over = _motif()
    cloth = weave(SIZE, over, THREADS, seed=51)
    worn = mix(0.75, 1.0, cloth.thread) * mix(0.55, 1.0, smoothstep(0, 0.8, cloth.height))
    silk = mix(colour("#3c0510"), colour("#8f1226"), worn)
    height = blur(cloth.height, 0.6)
    return normal_map(
        height,
        0.0035,
        {
            "type": "blendbsdf",
            "weight": bitmap(blur(cloth.warp, 0.4).clip(0, 1)),
            "gilt": {
                "type": "principled",
                "base_color": {"type": "rgb", "value": colour("#e3b653").tolist()},
                "metallic": 0.9,
                "roughness": bitmap(mix(0.5, 0.36, worn)),
                "anisotropic": 0.8,
            },
            "silk": {
                "type": "principled",
                "base_color": bitmap(silk),
                "roughness": 0.7,
                "specular": 0.4,
                "sheen": 0.6,
                "sheen_tint": 0.8,
                "clearcoat": 0.25,
                "clearcoat_gloss": 0.1,
            },
        },
    )
