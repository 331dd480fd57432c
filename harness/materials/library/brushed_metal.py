"""Brushed steel: the narrowest, most stretched highlight of the twelve, no relief."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness.textures.maps import anisotropic_alpha, bitmap, mix, ramp, unit_range
from harness.textures.noise import blur, fbm
from harness.textures.patterns import scratches
from harness.textures.sizes import SIZE

SUMMARY = "anisotropic: brushed steel, a narrow highlight stretched across the brushing"


def bsdf() -> dict[str, Any]:
    """Brushing runs along u, so alpha_v is the larger; streaks vary both."""
    random = np.random.default_rng(121)
    streaks = unit_range(
        blur(random.normal(size=(SIZE, SIZE)), (18, 0.5))
        + 0.6 * blur(random.normal(size=(SIZE, SIZE)), (45, 1.5))
    )
    smudge = unit_range(fbm(SIZE, (3, 2), seed=122, octaves=4))
    scratch = scratches(SIZE, 60, (0.1, 0.45), 0.003, 0.04, seed=123)
    alpha = mix(0.11, 0.17, smudge) * mix(0.85, 1.2, streaks)
    alpha_v, alpha_u = anisotropic_alpha(alpha, mix(5.0, 3.5, smudge))
    tone = ramp(
        (0.15 + 0.75 * streaks + 0.25 * scratch).clip(0, 1),
        [(0, "#84888c"), (0.5, "#b9bcbe"), (1, "#e8e8e6")],
    )
    return {
        "type": "roughconductor",
        "distribution": "ggx",
        "material": "none",
        "specular_reflectance": bitmap(tone),
        "alpha_u": bitmap(alpha_u),
        "alpha_v": bitmap(alpha_v),
    }
