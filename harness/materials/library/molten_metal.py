"""Molten metal, set: flowing ridges whose highlight is stretched, and rougher slag."""

from __future__ import annotations

from typing import Any

from harness.textures.maps import (
    anisotropic_alpha,
    bitmap,
    mix,
    normal_map,
    ramp,
    smoothstep,
    unit_range,
)
from harness.textures.noise import blur, fbm, gradient_noise, grid
from harness.textures.sizes import SIZE

SUMMARY = "anisotropic and normal-mapped: flows of set bronze with rougher slag"


def bsdf() -> dict[str, Any]:
    """Bent stripes of flow; both roughnesses vary, their ratio with the flow."""
    u, v = grid(SIZE)
    du, dv = 0.10 * fbm(SIZE, (2, 2), seed=111), 0.10 * fbm(SIZE, (2, 2), seed=112, octaves=2)
    flow = gradient_noise(u + du, v + dv, (3, 9), 113) + 0.4 * gradient_noise(
        u + du, v + 2 * dv, (4, 22), 114
    )
    flow = unit_range(flow)
    slag = smoothstep(0.7, 1.5, fbm(SIZE, (5, 5), seed=115, octaves=5))
    height = blur(flow + 0.1 * slag, 1.5)
    tint = unit_range(flow + 0.25 * fbm(SIZE, (6, 6), seed=116))
    metal = ramp(tint, [(0, "#5e3a22"), (0.4, "#b87838"), (0.75, "#e0ae68"), (1, "#f6dcaa")])
    alpha = mix(mix(0.2, 0.13, flow), 0.42, slag)
    alpha_u, alpha_v = anisotropic_alpha(alpha, mix(mix(4.0, 2.2, flow), 1.0, slag))
    return normal_map(
        height,
        0.05,
        {
            "type": "roughconductor",
            "distribution": "ggx",
            "material": "none",
            "specular_reflectance": bitmap(mix(metal, 0.25 * metal, slag)),
            "alpha_u": bitmap(alpha_u),
            "alpha_v": bitmap(alpha_v),
        },
    )
