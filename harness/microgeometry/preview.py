"""Pictures of a reflectance: a plane or a sphere of it under a small studio.

A picture is a set of queries and the light that each stands for (:class:`Shots`), so that the
path-traced truth and a network's answer to the same queries can be put side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from harness.core.protocol.disk import to_direction
from harness.core.protocol.errors import InputError
from harness.microgeometry.queries import truth

KEY = (-0.45, 0.5)
"""Projection of the key light's direction on the picture's plane (left and above)."""


class Shots(NamedTuple):
    """Queries that make a picture; M of them, several per pixel."""

    pixel: Tensor
    """Index [M] of the pixel, row by row from the top."""
    u: Tensor
    kernel: Tensor
    wi: Tensor
    wo: Tensor
    weight: Tensor
    """Irradiance [M] that the query's light brings, so that the pixel is a sum of f times it."""
    shape: tuple[int, int]
    """Height and width of the picture."""


Reflectance = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""``(u, kernel, wi, wo) -> f [M, 3]``, as :func:`harness.microgeometry.queries.truth`."""


def plane_shots(
    resolution: int | tuple[int, int],
    wi: tuple[float, float] = (0.0, 0.0),
    wo: tuple[float, float] = KEY,
    tiles: float = 1.0,
    spp: int = 1,
    seed: int = 0,
    dome: float = 0.0,
) -> Shots:
    """Queries of a plane seen from ``wi`` by a distant camera, ``tiles`` of it across.

    Pixels are places on the reference plane, u to the right and v upwards, lit from ``wo``
    with unit irradiance across the beam times pi; ``dome`` adds a studio of that strength.
    """
    height, width = (resolution, resolution) if isinstance(resolution, int) else resolution
    generator = torch.Generator().manual_seed(seed)
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    u = torch.stack([(column + 0.5) / width, (height - row - 0.5) / width], -1).view(-1, 2) * tiles
    n = height * width
    local = torch.eye(3).expand(n, 3, 3)
    camera = to_direction(torch.tensor(wi)).expand(n, 3)
    footprint = torch.full((n,), 0.5 * tiles / width)
    light = to_direction(torch.tensor(wo))
    return _lit(u, footprint, camera, local, light, dome, spp, generator, (height, width))


def sphere_shots(
    resolution: int,
    tiles: float = 3.0,
    wo: tuple[float, float] = KEY,
    spp: int = 1,
    seed: int = 0,
    dome: float = 1.0,
) -> Shots:
    """Queries of a sphere that fills the picture, seen by a distant camera along -z.

    The tile is wrapped ``2 tiles`` times around it and ``tiles`` times from pole to pole.
    Pixels off the sphere have no query.
    """
    generator = torch.Generator().manual_seed(seed)
    row, column = torch.meshgrid(torch.arange(resolution), torch.arange(resolution), indexing="ij")
    x, y = (2 * column + 1) / resolution - 1, 1 - (2 * row + 1) / resolution
    # A little smaller than the picture; the last texels at its rim have no direction.
    p = torch.stack([x, y], -1).view(-1, 2) / 0.96
    on = p.square().sum(1) < 0.9999
    normal = to_direction(p[on])
    # The pole is tilted towards the camera, out of sight of the seam at its back.
    tangent = torch.nn.functional.normalize(
        torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]).expand_as(normal), normal), dim=1
    )
    local = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], 1)
    longitude = torch.atan2(normal[:, 0], normal[:, 2]) / math.pi
    latitude = torch.asin(normal[:, 1]) / math.pi
    u = torch.stack([longitude, latitude], 1) * tiles
    camera = torch.tensor([0.0, 0.0, 1.0]).expand_as(normal)
    # A pixel spans this much of the tile at the middle, and more towards the rim.
    footprint = tiles / (math.pi * resolution * 0.48 * normal[:, 2].clamp(min=0.2).sqrt()) / 2
    light = to_direction(torch.tensor(wo))
    shots = _lit(u, footprint, camera, local, light, dome, spp, generator, (resolution, resolution))
    return shots._replace(pixel=torch.nonzero(on)[:, 0][shots.pixel])


def perspective_shots(
    resolution: int,
    tiles: float = 2.0,
    tilt: float = 50.0,
    wo: tuple[float, float] = KEY,
    spp: int = 1,
    seed: int = 0,
    dome: float = 0.4,
) -> Shots:
    """Queries of a plane that a camera sees ``tilt`` degrees from its normal, near by.

    About ``tiles`` of it are across the middle of the picture. Footprints grow with distance,
    as a renderer's do: a pixel's width, and its height over the cosine, in the mean.
    """
    generator = torch.Generator().manual_seed(seed)
    row, column = torch.meshgrid(torch.arange(resolution), torch.arange(resolution), indexing="ij")
    half = math.tan(math.radians(15.0))
    x = ((2 * column + 1) / resolution - 1).reshape(-1) * half
    y = (1 - (2 * row + 1) / resolution).reshape(-1) * half
    sine, cosine = math.sin(math.radians(tilt)), math.cos(math.radians(tilt))
    distance = tiles / (2 * half)
    eye = distance * torch.tensor([0.0, -sine, cosine])
    forward, up = torch.tensor([0.0, sine, -cosine]), torch.tensor([0.0, cosine, sine])
    ray = x[:, None] * torch.tensor([1.0, 0, 0]) + y[:, None] * up + forward
    ray = torch.nn.functional.normalize(ray, dim=1)
    if bool((ray[:, 2] >= 0).any()):
        raise InputError(f"tilt: expected the plane to fill the picture, got {tilt} degrees")
    t = -eye[2] / ray[:, 2]
    u = eye[:2] + t[:, None] * ray[:, :2]
    # Half the spacing of pixels there, in the geometric mean of the plane's two directions.
    footprint = t * half / resolution / (-ray[:, 2]).sqrt()
    local = torch.eye(3).expand(len(u), 3, 3)
    light = to_direction(torch.tensor(wo))
    shape = (resolution, resolution)
    return _lit(u, footprint, -ray, local, light, dome, spp, generator, shape)


def develop(shots: Shots, reflectance: Reflectance) -> Tensor:
    """The picture [H, W, 3], linear, from anything that answers the queries."""
    f = reflectance(shots.u, shots.kernel, shots.wi, shots.wo)
    height, width = shots.shape
    image = torch.zeros(height * width, 3, dtype=f.dtype, device=f.device)
    image.index_add_(0, shots.pixel.to(f.device), f * shots.weight.to(f.device)[:, None])
    return image.view(height, width, 3)


def plane(
    surface: Any,
    resolution: int | tuple[int, int],
    wi: tuple[float, float] = (0.0, 0.0),
    wo: tuple[float, float] = KEY,
    spp: int = 16,
    tiles: float = 1.0,
    dome: float = 0.0,
    seed: int = 0,
    device: str = "cpu",
) -> Tensor:
    """The path-traced plane of :func:`plane_shots`: [H, W, 3], linear."""
    shots = plane_shots(resolution, wi, wo, tiles, spp, seed, dome)
    return develop(shots, _tracing(surface, spp, seed, device, dome))


def sphere(
    surface: Any,
    resolution: int,
    wo: tuple[float, float] = KEY,
    spp: int = 16,
    tiles: float = 3.0,
    dome: float = 1.0,
    seed: int = 0,
    device: str = "cpu",
) -> Tensor:
    """The path-traced sphere of :func:`sphere_shots`: [H, W, 3], linear."""
    shots = sphere_shots(resolution, tiles, wo, spp, seed, dome)
    return develop(shots, _tracing(surface, spp, seed, device, dome))


def perspective(
    surface: Any,
    resolution: int,
    wo: tuple[float, float] = KEY,
    spp: int = 16,
    tiles: float = 2.0,
    tilt: float = 50.0,
    dome: float = 0.4,
    seed: int = 0,
    device: str = "cpu",
) -> Tensor:
    """The path-traced plane of :func:`perspective_shots`: [H, W, 3], linear."""
    shots = perspective_shots(resolution, tiles, tilt, wo, spp, seed, dome)
    return develop(shots, _tracing(surface, spp, seed, device, dome))


def _tracing(surface: Any, spp: int, seed: int, device: str, dome: float) -> Reflectance:
    # With a dome there are spp directions a pixel already, each with a path of its own.
    samples = 1 if dome > 0 else spp
    return lambda u, kernel, wi, wo: truth(
        surface, u, kernel, wi, wo, samples, seed, depth=4, device=device
    )


def srgb(image: NDArray[Any]) -> NDArray[Any]:
    """A linear picture as sRGB in [0, 1], for a file to look at; brighter than white is white."""
    x = np.clip(image, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def studio(direction: Tensor) -> Tensor:
    """Radiance [...] of the dome in world directions [..., 3]: soft boxes over a grey floor."""
    x, y, z = direction.unbind(-1)

    def box(value: Tensor, middle: float, half: float, soft: float) -> Tensor:
        return torch.sigmoid((half - (value - middle).abs()) / soft)

    above = 0.25 + 0.35 * torch.sigmoid(4 * y)
    left = 2.2 * box(x, -0.75, 0.22, 0.04) * box(y, 0.3, 0.5, 0.05) * torch.sigmoid(10 * z)
    right = 1.2 * box(x, 0.85, 0.12, 0.04) * box(y, 0.1, 0.6, 0.05)
    roof = 1.6 * box(y, 0.9, 0.12, 0.04)
    return above + left + right + roof


def _towards_lobe(wi: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Directions [N, 2] and their density [N] on the disk; a density of 0 marks those off it.

    Half are uniform, half normal around the mirror direction, where most light comes from.
    """
    n, sigma = len(wi), 0.3
    random = torch.rand(3, n, generator=generator)
    turn = 2 * math.pi * random[1]
    uniform = random[0].sqrt()[:, None] * torch.stack([turn.cos(), turn.sin()], 1)
    lobe = sigma * torch.randn(n, 2, generator=generator) - wi
    wo = torch.where(random[2:].T < 0.5, uniform, lobe)
    near = torch.exp(-0.5 * ((wo + wi) / sigma).square().sum(1)) / (2 * math.pi * sigma**2)
    density = 0.5 / math.pi + 0.5 * near
    return wo, torch.where(wo.square().sum(1) < 1, density, torch.zeros_like(density))


def _lit(
    u: Tensor,
    footprint: Tensor,
    camera: Tensor,
    local: Tensor,
    light: Tensor,
    dome: float,
    spp: int,
    generator: torch.Generator,
    shape: tuple[int, int],
) -> Shots:
    """Shots of places with a frame [N, 3, 3] (rows: tangent, bitangent, normal), in the world."""
    n = len(u)
    pixel = torch.arange(n)
    wi = (local @ camera[:, :, None])[:, :2, 0]
    to_light = local @ light
    repeats = spp if dome > 0 else 1
    # Below that, rounding may put the direction off the disk, and light brings nothing.
    lit = to_light[:, 2] > 1e-3
    irradiance = math.pi * to_light[:, 2].clamp(min=0) / repeats
    parts = [(pixel[lit], to_light[lit, :2], irradiance[lit]) for _ in range(repeats)]
    for _ in range(repeats if dome > 0 else 0):
        wo, density = _towards_lobe(wi, generator)
        on = density > 0
        world = (to_direction(wo[on])[:, None] @ local[on])[:, 0]
        # On the disk, f times cosine over the hemisphere is the integral of f.
        parts.append((pixel[on], wo[on], dome / repeats * studio(world) / density[on]))
    index, wo, weight = (torch.cat(x) for x in zip(*parts, strict=True))
    return Shots(
        index,
        u[index].contiguous(),
        footprint[index],
        wi[index].contiguous(),
        wo.contiguous(),
        weight,
        shape,
    )
