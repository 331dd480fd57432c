"""Tileable textures of the named materials: seeded, numpy only.

All fields are float arrays [size, size]; row index grows with ``v``, column index with
``u``, both wrap around, and texel ``(i, j)`` is centred at ``v = (i + 1/2) / size``,
``u = (j + 1/2) / size``, which is how Mitsuba reads a bitmap.
"""

from harness.materials.procedural.maps import (
    anisotropic_alpha,
    bitmap,
    colour,
    mix,
    normal_map,
    normals,
    ramp,
    smoothstep,
    unit_range,
)
from harness.materials.procedural.noise import (
    Cells,
    blur,
    cellular,
    fbm,
    gradient_noise,
    grid,
    sample,
    warped,
)
from harness.materials.procedural.patterns import (
    Planks,
    Weave,
    box_distance,
    panels,
    planks,
    rivets,
    scratches,
    segment_distance,
    star_tiles,
    weave,
)

SIZE = 256
"""Texels along each side of the textures of the named materials."""

__all__ = [
    "SIZE",
    "Cells",
    "Planks",
    "Weave",
    "anisotropic_alpha",
    "bitmap",
    "blur",
    "box_distance",
    "cellular",
    "colour",
    "fbm",
    "gradient_noise",
    "grid",
    "mix",
    "normal_map",
    "normals",
    "panels",
    "planks",
    "ramp",
    "rivets",
    "sample",
    "scratches",
    "segment_distance",
    "smoothstep",
    "star_tiles",
    "unit_range",
    "warped",
    "weave",
]
