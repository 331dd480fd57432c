"""Meshes and spheres as plain data. Right-handed, y up; lengths have no unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Vec3 = tuple[float, float, float]
MaterialSpec = str | Mapping[str, Any]
"""As in a suite; see :mod:`harness.materials.registry`."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles. ``u`` x ``v`` tangents and normal are right-handed: dp_du x dp_dv ~ n.

    ``vertices`` [V, 3]; ``faces`` [F, 3] indices, counter-clockwise from outside;
    ``normals`` [V, 3] of unit length, or None for flat faces; ``uv`` [V, 2], which may leave
    [0, 1] (textures repeat). ``tested`` says whether it carries the material under test;
    ``material`` is another one's specification, None for a grey Lambertian one.
    """

    vertices: Array
    faces: NDArray[np.uint32]
    normals: Array | None
    uv: Array
    tested: bool = True
    material: MaterialSpec | None = None


@dataclass(frozen=True)
class Sphere:
    """A sphere with its poles on the y axis.

    ``u`` is the azimuth around y over a full turn (0 at -z, growing counter-clockwise seen
    from above, so that it grows along +x where the sphere faces +z), ``v`` grows from the
    south pole (0) to the north pole (1); both are then multiplied by ``uv_scale``. Equal
    scale of a square texture at the equator needs ``uv_scale = (2 k, k)``.
    """

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: float = 1.0
    uv_scale: tuple[float, float] = (4.0, 2.0)
    tested: bool = True
    material: MaterialSpec | None = None
    rows: int = 96
    """Rows of its tessellation; twice as many columns."""
