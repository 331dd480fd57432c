"""Polished marble: a smooth dielectric coat over a diffuse body, honed where veins run."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import bitmap, colour, mix, ramp, smoothstep, unit_range
from harness.textures.noise import blur, fbm, gradient_noise, grid
from harness.textures.sizes import SIZE

SUMMARY = "layered coat: polished ochre marble, a sharp coat over a diffuse body"


def _veins(seed: int, cells: int, width: float) -> np.ndarray:
    """Thin winding lines where bent noise crosses zero, [SIZE, SIZE] in [0, 1]."""
    u, v = grid(SIZE)
    du, dv = 0.06 * fbm(SIZE, (4, 4), seed=seed), 0.06 * fbm(SIZE, (4, 4), seed=seed + 1)
    return np.exp(-np.abs(gradient_noise(u + du, v + dv, (cells, cells), seed + 2)) / width)


def bsdf() -> dict[str, Any]:
    """Cloudy ochre body under a coat of index 1.7; the veins take less polish."""
    cloud = unit_range(fbm(SIZE, (3, 3), seed=71, octaves=6, gain=0.6))
    white = np.maximum(_veins(72, 2, 0.03), 0.6 * _veins(79, 5, 0.02))
    dark = _veins(76, 3, 0.014)
    body = ramp(cloud, [(0, "#9a5f20"), (0.4, "#d29a48"), (0.75, "#e9c27c"), (1, "#f6e3b8")])
    body = mix(body, colour("#f6efe0"), 0.85 * white)
    body = mix(body, colour("#5a3a22"), 0.7 * dark * smoothstep(0.3, 0.6, cloud))
    polish = blur(np.maximum(white, dark), 0.8).clip(0, 1)
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "int_ior": 1.7,
        "alpha": 0.07,
        "diffuse_reflectance": bitmap(body),
        "specular_reflectance": bitmap(mix(1.0, 0.35, polish)),
    }
