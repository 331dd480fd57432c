"""What a scene is: shapes, light, camera. Plain data, from which a renderer builds its own.

Conventions: right-handed world, y up; lengths have no unit; angles in degrees; radiance in
the renderer's unit, linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.geometry.primitives import Array, MaterialSpec, Mesh, Sphere, Vec3

TESTED = "tested"
"""Stands for the material under test where a scene lists materials."""


@dataclass(frozen=True)
class Camera:
    """Perspective camera; ``fov`` is its full angle across the image, in degrees.

    ``aspect`` is width over height. With the effect ``depth-of-field`` it has a lens of radius
    ``aperture``, in units of length, focused at ``focus`` units of length along the axis.
    """

    origin: Vec3
    target: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float = 30.0
    aspect: float = 1.0
    aperture: float = 0.0
    focus: float = 0.0


@dataclass(frozen=True)
class AreaLamp:
    """A rectangle that emits ``radiance`` from the side it faces.

    ``to`` is a point it faces; ``size`` its width and height, the height as near to ``up`` as
    it can be.
    """

    center: Vec3
    to: Vec3
    size: tuple[float, float]
    radiance: Vec3
    up: Vec3 = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class PointLamp:
    """A point that emits ``intensity``, in power per solid angle."""

    position: Vec3
    intensity: Vec3


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry, lights, camera, and the effects that the scene calls for.

    ``environment`` is a constant radiance, a latitude-longitude map [H, W, 3] as described in
    :mod:`harness.scenes.environment`, or None. ``effects`` are names of
    :mod:`harness.effects`, with their values as texts (``"indirect: 12"``); what is not named
    there is not simulated, so a lamp that is here may yet be dark.
    """

    name: str
    effects: tuple[str, ...]
    shapes: tuple[Sphere | Mesh, ...]
    environment: float | Array | None
    camera: Camera
    description: str = ""
    lamps: tuple[AreaLamp | PointLamp, ...] = ()

    media = False
    """Whether it has participating media."""

    @property
    def lights(self) -> frozenset[str]:
        """The kinds of light it has, as effects call them."""
        kinds = {"area-lights" if isinstance(x, AreaLamp) else "point-lights" for x in self.lamps}
        return frozenset(kinds | ({"environment"} if self.environment is not None else set()))

    @property
    def camera_has_lens(self) -> bool:
        """Whether depth of field can be had."""
        return self.camera.aperture > 0


@dataclass(frozen=True)
class XmlScene:
    """A user's own Mitsuba scene, in which BSDFs are replaced.

    ``file`` was found to be a Mitsuba scene with BSDFs of the ids in ``replace_bsdf``; each is
    replaced by the material of that specification, ``"tested"`` for the one under test.
    ``parameters`` stand for the file's ``$names``; ``lights``, ``camera_has_lens`` and ``media``
    say what the file has.
    """

    name: str
    file: Path
    replace_bsdf: Mapping[str, MaterialSpec]
    effects: tuple[str, ...] = field(default=("environment",))
    description: str = ""
    lights: frozenset[str] = frozenset({"environment"})
    camera_has_lens: bool = False
    media: bool = False
    parameters: Mapping[str, Any] = field(default_factory=dict)
