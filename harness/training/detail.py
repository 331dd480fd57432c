"""How much of a surface is too fine for a texture, known before anything is trained.

A texture that is right at its texels is bilinear between them. Whatever a network makes of the
features, it can hardly follow an energy that bends more than that within a texel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import luminance
from harness.core.streams import generator
from harness.materials.neural import textures
from harness.microgeometry import queries

COSINES = (1.0, 0.7, 0.35)
"""Of the cameras that :func:`measure` asks for."""


class Detail(NamedTuple):
    """What a bilinear texture misses in the middle of four texels, relative to the energy there."""

    cosine: float
    """Of the camera's direction wi."""
    missed: Tensor
    """[N], signed; with the noise of the paths."""
    noise: float
    """The median standard error of ``missed``, from that of the energies."""

    @property
    def share(self) -> float:
        """Of places where more than 5 % are missed."""
        return float((self.missed.abs() > 0.05).double().mean())


def measure(
    surface: Any,
    resolution: int,
    places: int = 512,
    paths: int = 2048,
    seed: int = 0,
    device: str = "cpu",
) -> list[Detail]:
    """At random places: the mean energy of four corners, a texel apart, over that in their middle.

    Energies are of the footprint of a texture of ``resolution``^2, under constant light, one set
    for each of :data:`COSINES`, with the camera at random azimuths.
    """
    random = torch.rand(places, 3, generator=generator(seed)).to(device)
    corners = torch.tensor([(0, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)], device=device)
    u = (random[:, None, :2] + 0.5 * corners / resolution) % 1
    kernel = u.new_full((places * len(corners),), textures.kernel_of(0, resolution))
    angle = 2 * torch.pi * random[:, 2]
    towards = torch.stack([angle.cos(), angle.sin()], 1)
    found = []
    for cosine in COSINES:
        wi = (towards * (1 - cosine**2) ** 0.5).repeat_interleave(len(corners), 0)
        traced = queries.energy(surface, u.view(-1, 2), kernel, wi, paths, seed, device=device)
        energy, error = (luminance(x).view(places, -1) for x in traced)
        missed = energy[:, 1:].mean(1) / energy[:, 0] - 1
        noise = torch.hypot(error[:, 0], error[:, 1:].norm(dim=1) / 4) / energy[:, 0]
        found.append(Detail(cosine, missed, float(noise.median())))
    return found
