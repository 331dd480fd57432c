"""What a scene is: shapes, light, camera. Plain data, from which a renderer builds its own.

Conventions: right-handed world, y up; lengths have no unit; angles in degrees; radiance in
the renderer's unit, linear Rec. 709.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles. ``u`` x ``v`` tangents and normal are right-handed: dp_du x dp_dv ~ n.

    ``vertices`` [V, 3]; ``faces`` [F, 3] indices, counter-clockwise from outside;
    ``normals`` [V, 3] of unit length, or None for flat faces; ``uv`` [V, 2], which may leave
    [0, 1] (textures repeat). ``tested`` says whether it carries the material under test.
    """

    vertices: Array
    faces: NDArray[np.uint32]
    normals: Array | None
    uv: Array
    tested: bool = True


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


@dataclass(frozen=True)
class Camera:
    """Perspective camera with a square image; ``fov`` its full angle, in degrees."""

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float = 30.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry, light, camera, and the effects that the scene calls for.

    ``environment`` is either a constant radiance or a latitude-longitude map [H, W, 3] as
    described in :mod:`harness.scenes.environment`. ``effects`` are names of
    :mod:`harness.scenes.effects`; nothing that is not named there is simulated.
    """

    name: str
    effects: tuple[str, ...]
    shapes: tuple[Sphere | Mesh, ...]
    environment: float | Array
    camera: Camera
    description: str = ""


@dataclass(frozen=True)
class XmlScene:
    """A user's own Mitsuba scene, in which one BSDF is replaced by the one under test.

    ``file`` was found to be a Mitsuba scene with a BSDF of the id ``replace_bsdf``.
    """

    name: str
    file: Path
    replace_bsdf: str
    effects: tuple[str, ...] = field(default=("environment",))
    description: str = ""
