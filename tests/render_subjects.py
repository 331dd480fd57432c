"""Materials and methods for tests of renders."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from harness.core import registry
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes

mi = variant.use("cpu")


from harness.materials.mitsuba_bsdf import MitsubaMaterial  # noqa: E402


def mitsuba(name: str, **bsdf: object) -> MitsubaMaterial:
    """One of Mitsuba's own."""
    return MitsubaMaterial(name, {"type": name, **bsdf}, {"type": "test", "name": name})


def white() -> MitsubaMaterial:
    """Lambertian, reflects everything."""
    return mitsuba("diffuse", reflectance={"type": "rgb", "value": 1.0})


def rough() -> MitsubaMaterial:
    """A broad highlight on a coloured ground."""
    return mitsuba(
        "principled", base_color={"type": "rgb", "value": [0.6, 0.4, 0.2]}, roughness=0.5
    )


class UniformDisk(Method):
    """The cosine sampler again, in torch and by the same formulas."""

    name = "uniform-disk"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = 2 * math.pi * u[:, 1]
        wo = u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(inside_disk(wo), 1 / math.pi, 0)


class White(Material):
    """Lambertian, in torch; grey of any albedo."""

    name = "white"

    def __init__(self, albedo: float = 1.0):
        self.albedo = albedo

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        value = torch.where(inside_disk(wo), self.albedo / math.pi, 0)
        return value[:, None].expand(-1, 3)

    def identity(self) -> dict[str, object]:
        """See :meth:`Material.identity`."""
        return {"type": "test", "name": self.name}


def ready(name: str | Method, material: Material, **parameters: object) -> Method:
    """A method, fitted briefly."""
    method = registry.make(name, **parameters) if isinstance(name, str) else name
    budget = Budget(steps=20, conditions=32, directions=16, resolution=16, pool=64)
    method.fit(material, budget, torch.Generator().manual_seed(0))
    return method


# --- renders ---------------------------------------------------------------------------

SCENE = scenes.make("uniform-sphere")
