"""f of walked surfaces by paths towards the light, beside walks, which never look for one."""

from __future__ import annotations

import math

import pytest
import torch

from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.core.protocol.errors import InputError
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.evaluation import evaluate
from tests.walks import rng

N, CELLS = 1 << 17, 4


def bed(micro, **more):
    primitives = {"shape": "sphere", "per_side": 4, "size": 0.4, "seed": 1}
    return parse({"name": "mine", "about": "x", "primitives": primitives, "micro": micro, **more})


def pairs(n: int, wi: list[float]):
    random = rng(3)
    u, wo = torch.rand(n, 2, generator=random), square_to_disk(torch.rand(n, 2, generator=random))
    return u, torch.tensor(wi).expand(n, 2).contiguous(), wo


@pytest.mark.parametrize(
    ("micro", "more"),
    [
        ({"bsdf": "lambertian", "reflectance": "#d89070"}, {"ground": "lambertian"}),
        ({"bsdf": {"type": "roughconductor", "material": "none", "alpha": 0.4}}, {}),
    ],
)
def test_evaluations_have_the_mean_of_walks(micro, more):
    """The integral of f over each of 16 cells of directions is the share of particles there."""
    surface, wi = bed(micro, **more), [0.5, 0.3]
    u, rows, wo = pairs(N, wi)
    f = evaluate(surface, u, rows, wo, seed=1).double()
    channel = torch.arange(N) % 3
    exits = surface.walk(u, rows, channel, seed=2)
    for of in range(3):
        here, walks = channel == of, int((channel == of).sum())
        left = torch.bincount(cell(exits.wo[exits.left & here]), minlength=CELLS**2)
        share = left.double() / walks
        for k in range(CELLS**2):
            inside = math.pi * f[:, of] * (cell(wo) == k)
            error = math.hypot(
                float(inside.std()) / math.sqrt(N),
                float((share[k] * (1 - share[k]) / walks).sqrt()),
            )
            assert abs(float(inside.mean() - share[k])) < 4.5 * error


def cell(wo: torch.Tensor) -> torch.Tensor:
    at = (disk_to_square(wo.double()) * CELLS).long().clamp(0, CELLS - 1)
    return at[:, 0] * CELLS + at[:, 1]


def test_a_mirror_cannot_be_evaluated():
    with pytest.raises(InputError, match="mine: a mirror cannot be evaluated"):
        evaluate(bed("mirror"), *pairs(16, [0.1, 0.0]), seed=1)
