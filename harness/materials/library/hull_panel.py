"""Science-fiction hull: painted and bare panels, rivets, worn edges, two kinds of lobe."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, colour, mix, normal_map, smoothstep, unit_range
from harness.textures.noise import blur, fbm, grid
from harness.textures.patterns import box_distance, panels, rivets, scratches
from harness.textures.sizes import SIZE

SUMMARY = "spatially varying mixture: hull panels of worn paint and bare metal, embossed"


def bsdf() -> dict[str, Any]:
    """Metal where paint is worn from edges and scratches; some panels are bare."""
    u, v = grid(SIZE)
    distance, number, boxes = panels(SIZE, 0.14, seed=83)
    big = [b for b in boxes if min(b[2] - b[0], b[3] - b[1]) > 0.17]
    corners = [
        (cu, cv)
        for u0, v0, u1, v1 in big
        for cu in (u0 + 0.026, u1 - 0.026)
        for cv in (v0 + 0.026, v1 - 0.026)
    ]
    rivet = rivets(SIZE, corners, 0.011)
    slots = np.zeros_like(u)
    for k, (u0, v0, u1, v1) in enumerate(big):
        if k % 3 == 0:  # louvres
            inside = box_distance(u, v, (u0 + 0.05, v0 + 0.05, u1 - 0.05, v1 - 0.05)) < 0
            slots = np.maximum(slots, inside * smoothstep(0.1, 0.5, np.sin(2 * np.pi * v * 32)))
    step = np.floor(number * 3) / 3
    groove = smoothstep(0.003, 0.011, distance)
    scratch = scratches(SIZE, 70, (0.05, 0.3), 0.004, np.inf, seed=82)
    dirt = fbm(SIZE, (4, 4), seed=84, octaves=5)
    wear = smoothstep(0.55, 1.05, 0.75 * np.exp(-distance / 0.016) + 0.28 * dirt + 0.25 * rivet)
    bare = np.maximum.reduce([wear, scratch, (number > 0.8).astype(float)])
    bare = (bare * groove).clip(0, 1)
    height = blur(groove * (0.55 + 0.3 * step) - 0.45 * slots + 0.35 * rivet - 0.05 * scratch, 0.8)

    paint = mix(colour("#68767d"), colour("#a9b4b5"), unit_range(dirt))
    paint = np.where((number < 0.16)[..., None], colour("#c2571a"), paint)
    paint = np.where(((number > 0.16) & (number < 0.34))[..., None], colour("#2d3940"), paint)
    stain = mix(0.45, 1.0, smoothstep(-1.4, 0.3, dirt) * smoothstep(0, 0.03, distance))
    metal = mix(colour("#8f8a84"), colour("#cfc9c0"), unit_range(dirt))
    cavity = mix(0.25, 1.0, groove * (1 - slots))
    base = mix(paint * stain[..., None], metal, bare) * cavity[..., None]
    rough = mix(0.5 + 0.12 * unit_range(-dirt), 0.29 + 0.12 * unit_range(dirt), bare)
    return normal_map(
        height,
        0.011,
        {
            "type": "principled",
            "base_color": bitmap(base),
            "roughness": bitmap(mix(0.8, rough, groove)),
            "metallic": bitmap(bare),
            "specular": 0.5,
        },
    )
