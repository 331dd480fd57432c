"""Varnished boards: an anisotropic fibre highlight under a satin coat."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, mix, normal_map, ramp, smoothstep, unit_range
from harness.textures.noise import blur, fbm, gradient_noise, grid
from harness.textures.patterns import planks
from harness.textures.sizes import SIZE

SUMMARY = "anisotropic and coated: varnished walnut boards, fibre highlight under a satin coat"


def bsdf() -> dict[str, Any]:
    """Rings stretched along the boards (u); each board has its own grain and tone."""
    u, v = grid(SIZE)
    board = planks(SIZE, boards=5, joints=1, seed=103)
    # A whole number of lattice rows keeps the grain tileable whatever a board's shift.
    du, dv = board.shift, np.floor(board.board * 40) / 40
    broad = gradient_noise(u + du, v + dv, (2, 10), 104)
    waves = gradient_noise(u + du, v + dv, (4, 20), 105)
    rings = 0.5 + 0.5 * np.cos(2 * np.pi * (9 * broad + 1.6 * waves))
    fibre = fbm(SIZE, (6, 90), seed=106, octaves=2)
    pores = smoothstep(1.0, 1.9, fbm(SIZE, (14, 120), seed=107, octaves=1))
    tone = 0.6 * rings**1.5 + 0.1 * fibre + 0.4 * board.board
    browns = [(0, "#c08a4e"), (0.35, "#9a5f2c"), (0.7, "#653516"), (1, "#33190b")]
    wood = ramp(unit_range(tone), browns)
    seam = smoothstep(0.0035, 0.009, board.seam)
    bevel = smoothstep(0, 0.02, board.seam)
    height = blur(seam * (0.7 + 0.3 * bevel) - 0.05 * pores - 0.012 * fibre, 0.8)
    base = wood * mix(0.2, 1.0, seam * (1 - 0.6 * pores))[..., None]
    return normal_map(
        height,
        0.009,
        {
            "type": "principled",
            "base_color": bitmap(base),
            "roughness": bitmap(mix(0.36, 0.5, unit_range(fibre))),
            "specular": 0.6,
            "metallic": 0.3,  # the part of the highlight that takes the colour of the fibres
            "anisotropic": 0.85,
            "clearcoat": bitmap(seam * (1 - pores)),
            "clearcoat_gloss": 0.4,
        },
    )
