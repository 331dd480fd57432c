"""A material with effects of its own, and scenes in which an effect does something or nothing."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import torch
from torch import Tensor

from harness.core.protocol import counting
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.geometry.primitives import Sphere
from harness.scenes.base import AreaLamp, Camera, PointLamp, Scene

OWN = frozenset({"parallax", "prefiltering", "multiple-scattering", "media"})


class Offset(Material):
    """Lambertian stripes in torch, shifted with the view by a network that is counted.

    ``prefiltering`` averages the stripes away, ``multiple-scattering`` and ``media`` make it
    brighter, each by so much. ``strength`` 0: its effects change nothing.
    """

    name = "offset"
    n_address = 2
    effects = OWN

    def __init__(self, strength: float = 1.0):
        self.strength = strength

    def with_effects(self, effects: frozenset[str]) -> Material:
        """See :meth:`Material.with_effects`."""
        other = copy.copy(self)
        other.effects = effects & self.effects
        return other

    def places(self, uv: Tensor) -> Tensor:
        """See :meth:`Material.places`."""
        return uv

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        u = condition[:, 0]
        if "parallax" in self.effects:
            counting.add("parallax", len(condition))
            u = u + 0.05 * self.strength * condition[:, -1]
        contrast = 0.3 * self.strength
        if "prefiltering" in self.effects:
            counting.add("prefiltering", len(condition))
            contrast = 0.0
        albedo = 0.5 + contrast * torch.sin(40 * u)
        for name in ("multiple-scattering", "media"):
            if name in self.effects:
                counting.add(name, len(condition))
                albedo = albedo + 0.1 * self.strength
        value = torch.where(inside_disk(wo), albedo / math.pi, 0)
        return value[:, None] * torch.tensor([1.0, 0.8, 0.6])

    def identity(self) -> dict[str, object]:
        """See :meth:`Material.identity`."""
        return {"type": "test", "strength": self.strength}


FLOOR = {
    "name": "floor",
    "type": "mitsuba",
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}},
}


def hall(*effects: str, apart: bool = False, dark: str = "", grey: bool = False) -> Scene:
    """Two balls, the tested one and another, in all kinds of light.

    ``apart``: neither ball sees the other. ``dark`` names a kind of light that gives none.
    ``grey``: no light has a colour.
    """
    tint = (1.0, 1.0, 1.0) if grey else (1.0, 0.7, 0.4)

    def radiance(kind: str, value: float) -> tuple[float, float, float]:
        return tuple(0.0 if kind == dark else value * x for x in tint)

    # A dark lamp is far away, too: where it is, it stands in the way.
    place = (2000.0, 3000.0, 2000.0) if dark == "area-lights" else (2.0, 3.0, 2.0)
    far = (0.0, -1e4, 0.0) if apart else (0.0, -5.2, 0.0)
    lamps = (
        AreaLamp(place, (0.0, 0.0, 0.0), (1.5, 1.5), radiance("area-lights", 6.0)),
        PointLamp((-3.0, 2.0, 3.0), radiance("point-lights", 9.0)),
    )
    shapes = (
        Sphere(rows=24),
        Sphere(center=far, radius=4.0, tested=False, material=FLOOR, rows=24),
    )
    return Scene(
        "hall",
        effects,
        shapes,
        0.0 if dark == "environment" else 0.5,
        Camera((0.0, 0.5, 5.0), (0.0, 0.0, 0.0), fov=28.0, aperture=0.3, focus=5.0),
        lamps=lamps,
    )


def without_lens(scene: Scene, aperture: float = 1e-5) -> Scene:
    """The scene with a lens so small that it blurs nothing."""
    return replace(scene, camera=replace(scene.camera, aperture=aperture))
