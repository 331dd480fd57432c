"""Conditions of the hard cases: [2, C] rows of a material, made for one difficulty each.

Each function takes ``(material, generator, device)``, as
:class:`~harness.checks.catalogue.HardCase` asks for.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.material import Material

Conditions = Callable[[Material, torch.Generator, str], Tensor]

PLACES = 64
"""Random places to choose from."""
LOOKS = 64
"""Random directions that tell a lit place from a black one."""

ALMOST_NORMAL = (0.06, 0.08)
OBLIQUE = (-0.72, 0.54)
"""Sines 0.1 and 0.9; on no axis and no edge of a grid."""


def normal_and_oblique(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """wi near the normal and at 64 degrees from it."""
    return _placed(material, [ALMOST_NORMAL, OBLIQUE], generator, device)


def normal(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """wi = 0, which has no azimuth, and wi so short that its square all but vanishes."""
    return _placed(material, [(0.0, 0.0), (1e-9, -2e-9)], generator, device)


def horizontal(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """wi of length one, in single precision too: only the axes are."""
    return _placed(material, [(-1.0, 0.0), (0.0, 1.0)], generator, device)


def grazing(cosine: float) -> Conditions:
    """wi at the given cosine from the normal.

    One row has that cosine to a percent, single precision or not (:func:`at_cosine`). The other
    is what a renderer makes of such a direction: a unit vector, each coordinate rounded. Its
    squared length is then off by some 1e-7, and from 1e-4 on this one lies beyond the rim.
    """
    sine, turn = math.sqrt(1 - cosine**2), 2.4
    rounded = (sine * math.cos(turn), sine * math.sin(turn))

    def conditions(material: Material, generator: torch.Generator, device: str) -> Tensor:
        return _placed(material, [at_cosine(cosine), rounded], generator, device)

    return conditions


def at_cosine(cosine: float) -> tuple[float, float]:
    """A point (x, y) of single-precision numbers with 1 - x^2 - y^2 = cosine^2 to a percent.

    Near an axis, where y is small and finely spaced and makes up for the rounding of x, and
    ``1 - x * x - y * y`` loses nothing, evaluated from the left.
    """
    squared = 1 - cosine**2
    x = torch.tensor(math.sqrt(squared) * math.cos(4e-4), dtype=torch.float32).item()
    return x, torch.tensor(math.sqrt(squared - x * x), dtype=torch.float32).item()


def far_features(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """Features 1e3 and 1e6 standard deviations from their mean, above and below.

    A texture of another unit, a height in millimetres, a latent code of another network.
    """
    rows = normal_and_oblique(material, generator, device)
    first, last = material.n_address, material.n_address + material.n_features
    seen = material.conditions(256, generator, device)[:, first:last]
    away = torch.tensor([[1e3], [-1e6]], device=device)
    rows[:, first:last] = seen.mean(0) + away * seen.std(0)
    return rows


def black_and_lit(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """A place without any reflection, and one with; wi oblique."""
    places = _with_wi(material.conditions(PLACES, generator, device), OBLIQUE)
    lit = _lit(material, places, generator)
    return torch.stack([places[~lit][0], places[lit][0]])


def polished(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """Rows of a family: least roughness, everything else in the middle; wi at cos 0.1 and 0.01."""
    low = [p.low if p.is_roughness else (p.low + p.high) / 2 for p in material.parameters]
    rows = [[*low, *at_cosine(cosine)] for cosine in (0.1, 0.01)]
    return torch.tensor(rows, device=device)


def _placed(
    material: Material, wi: list[tuple[float, float]], generator: torch.Generator, device: str
) -> Tensor:
    """One row for each ``wi``, at a lit place if one is found: in the dark most tests are void."""
    rows = []
    for one in wi:
        places = _with_wi(material.conditions(PLACES, generator, device), one)
        lit = _lit(material, places, generator).nonzero()[:, 0]
        rows.append(places[int(lit[0]) if len(lit) else 0])
    return torch.stack(rows)


def _with_wi(condition: Tensor, wi: tuple[float, float]) -> Tensor:
    condition = condition.clone()
    condition[:, -2:] = condition.new_tensor(wi)
    return condition


def _lit(material: Material, condition: Tensor, generator: torch.Generator) -> Tensor:
    """Whether any of some random directions reflects, bool [N]."""
    wo = square_to_disk(torch.rand(1, LOOKS, 2, generator=generator)).to(condition.device)
    return (material.target_grid(condition, wo) > 0).any(1)
