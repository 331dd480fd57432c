"""Nearly specular and strongly anisotropic metals, as Mitsuba's GGX conductor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from harness.core.protocol.material import Material
from harness.materials.hard.base import Made


def _metal(**alpha: float) -> Callable[[str, dict[str, Any]], Material]:
    def make(name: str, identity: dict[str, Any]) -> Material:
        # Imported here, for it loads Mitsuba.
        from harness.materials.mitsuba_bsdf import MitsubaMaterial

        bsdf = {"type": "roughconductor", "distribution": "ggx", "material": "Al", **alpha}
        return MitsubaMaterial(name, bsdf, identity)

    return make


_HERE = Path(__file__)
MATERIALS = {
    "specular-1e-1": Made("satin metal: GGX of roughness 0.1", _HERE, _metal(alpha=1e-1)),
    "specular-1e-2": Made("polished metal: GGX of roughness 0.01", _HERE, _metal(alpha=1e-2)),
    "specular-1e-3": Made("chrome: GGX of roughness 0.001", _HERE, _metal(alpha=1e-3)),
    # The least roughness that Mitsuba has: below it, its conductor is the same.
    "specular-1e-4": Made("a mirror, almost: GGX of roughness 0.0001", _HERE, _metal(alpha=1e-4)),
    "anisotropic-100": Made(
        "brushed metal: GGX of roughness 0.5 along, 0.005 across",
        _HERE,
        _metal(alpha_u=0.5, alpha_v=0.005),
    ),
}
