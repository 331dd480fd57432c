r"""How often a map of the plane covers a direction: folds, holes, and the bias that they make.

Estimates that are weighted by the signed determinant of a map T of normal points have the mean

.. math:: E_z\Big[f(T(z))\,\frac{\det J_T(z)}{N(z)}\Big] = \int f(\omega)\,\deg(T, \omega)\,d\omega

The degree of a direction is the sum of the determinants' signs over its preimages. Inside a
circle of radius R it is the winding number of the circle's image around the direction (the
argument principle of plane maps), so that no preimage has to be found: the circle is followed,
and its crossings of a ray are counted with their signs. R is the largest radius that uniforms of
single precision give; no sample is further out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.fitting.targets import cells

FURTHEST = math.sqrt(2 * 24 * math.log(2))
"""5.77: the radius of a normal point whose first uniform is the largest below one."""

Map = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Directions [B, D, 2] and signed determinants [B, D] of conditions [B, C], points [B, D, 2]."""


@dataclass(frozen=True)
class MapReport:
    """``folded``: share of samples of negative determinant; of p* the share ``missed`` (degree 0)
    and ``repeated`` (neither 0 nor 1). ``bias`` is the mean over conditions of the integral of
    p* (degree - 1), the relative error of an estimate's mean; ``worst`` its largest size."""

    folded: float
    missed: float
    repeated: float
    bias: float
    worst: float

    def line(self) -> str:
        """The report in a sentence."""
        return (
            f"{self.folded:.2%} of the samples folded; of p* {self.missed:.2%} not reached,"
            f" {self.repeated:.2%} covered more than once; bias {self.bias:+.2%}"
            f" (worst condition {self.worst:.2%})"
        )


@torch.no_grad()
def examine(
    map_: Map,
    material: Material,
    condition: Tensor,
    generator: torch.Generator,
    *,
    samples: int = 1024,
    points: int = 512,
    resolution: int = 32,
) -> MapReport:
    """Look at ``map_`` in the conditions [B, C]; black ones say nothing and are left out.

    ``samples`` normal points a condition for the folds; the circle has ``points`` corners, and
    the degree is found at one random point in each of ``resolution``^2 cells of equal area.

    Raises:
        InputError: the material is black in all of the conditions.
    """
    at = cells(resolution, torch.rand(len(condition), resolution**2, 2, generator=generator))
    at = at.to(condition)
    mass = material.target_grid(condition, at).double()
    lit = mass.sum(1) > 0
    if not lit.any():
        raise InputError(
            f"material '{material.name}' is black in all {len(condition)} conditions looked at;"
            " expected light to be reflected in some"
        )
    condition, mass, at = condition[lit], mass[lit], at[lit]
    mass = mass / mass.sum(1, keepdim=True)
    z = torch.randn(len(condition), samples, 2, generator=generator).to(condition)
    folded = float((map_(condition, z)[1] < 0).double().mean())
    turn = torch.arange(points, device=condition.device) * (2 * math.pi / points)
    circle = FURTHEST * torch.stack([turn.cos(), turn.sin()], -1)
    image, _ = map_(condition, circle.to(condition).expand(len(condition), -1, -1))
    degree = torch.stack([winding(*pair) for pair in zip(image, at, strict=True)]).double()
    off = (mass * (degree - 1)).sum(1)
    return MapReport(
        folded,
        float((mass * (degree == 0)).sum(1).mean()),
        float((mass * ((degree != 0) & (degree != 1))).sum(1).mean()),
        float(off.mean()),
        float(off.abs().amax()),
    )


def winding(polygon: Tensor, at: Tensor) -> Tensor:
    """How often the closed ``polygon`` [M, 2] turns around the points ``at`` [G, 2]: int [G].

    Signed crossings of the ray from each point to the right; counterclockwise is positive.
    """
    (x0, y0), (x1, y1) = polygon.unbind(-1), polygon.roll(-1, 0).unbind(-1)
    x, y = at[:, 0, None], at[:, 1, None]
    up, down = (y0 <= y) & (y1 > y), (y0 > y) & (y1 <= y)
    # Positive where the point is on the left of the edge.
    side = (x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)
    return ((up & (side > 0)).long() - (down & (side < 0)).long()).sum(1)
