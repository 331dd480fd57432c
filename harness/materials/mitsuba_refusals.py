"""Why a Mitsuba BSDF cannot be a material here, in one sentence each."""

from __future__ import annotations

from typing import Any

from harness.core.protocol.errors import InputError
from harness.materials import mitsuba_textures
from harness.materials.surface_inputs import REASONS, Seen

_CLASSES = {
    "Hair": "is of a fibre and scatters into all directions around it; expected a BSDF of surfaces",
    "Null": "is no surface: light passes straight through it",
    "MaskBSDF": "lets light pass straight through where its opacity is below one; expected the"
    " BSDF inside of it alone",
}


def check_kind(mi: Any, bsdf: Any, name: str) -> None:
    """Refuse what no density on the projected disk can represent, and data that only a mesh has."""
    where = f"material '{name}'"
    for _, node in mitsuba_textures.below(mi, bsdf):
        kind = node.class_name()
        if isinstance(node, mi.BSDF) and kind in _CLASSES:
            raise InputError(f"{where}: Mitsuba's {kind} {_CLASSES[kind]}")
    flags = bsdf.flags()
    if mi.has_flag(flags, mi.BSDFFlags.Null):
        raise InputError(f"{where}: lets light pass straight through; expected a reflective BSDF")
    if mi.has_flag(flags, mi.BSDFFlags.Delta):
        raise InputError(
            f"{where}: has a delta lobe, which no density can represent; expected rough lobes only"
        )
    if mi.has_flag(flags, mi.BSDFFlags.Transmission):
        raise InputError(f"{where}: transmits light; expected a reflective BSDF")
    for path, node in mitsuba_textures.below(mi, bsdf):
        if node.class_name() == "MeshAttribute":
            raise InputError(
                f"{where}: {path.lstrip('.')} is an attribute of a mesh (colours of vertices or"
                " faces), which only a scene has; a method is fitted without one: expected a"
                " texture, such as a bitmap"
            )


def check_seen(seen: Seen, name: str) -> None:
    """Refuse a BSDF that reads what no condition can carry."""
    where = f"material '{name}'"
    for what, reason in REASONS.items():
        if what in seen.reads:
            raise InputError(
                f"{where}: {reason}, which a method that is fitted without a scene cannot know"
            )
