"""Brushed suede: nearly diffuse, with a soft sheen. The easiest case for every method."""

from __future__ import annotations

from typing import Any

from harness.textures.maps import bitmap, normal_map, ramp, unit_range
from harness.textures.noise import blur, fbm
from harness.textures.sizes import SIZE

SUMMARY = "near-diffuse: brushed suede with a soft sheen"


def bsdf() -> dict[str, Any]:
    """Sheen over rough cloth; colour follows the brushed patches, normals the nap."""
    patches = fbm(SIZE, (3, 3), seed=11, octaves=3)
    nap = fbm(SIZE, (20, 44), seed=12, octaves=3, gain=0.7)
    shade = unit_range(0.9 * patches + 0.35 * nap)
    return normal_map(
        blur(nap, 0.7),
        0.0011,
        {
            "type": "principled",
            "base_color": bitmap(ramp(shade, [(0, "#5d3a22"), (0.5, "#8a5c38"), (1, "#b78a5c")])),
            "roughness": 0.95,
            "specular": 0.15,
            "sheen": 0.7,
            "sheen_tint": 0.6,
        },
    )
