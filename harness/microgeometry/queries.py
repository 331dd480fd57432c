"""Queries of the multi-resolution BTF: answered by path tracing, or drawn at random.

Names are the harness's: ``wi`` is the direction to the camera, ``wo`` to the light, both on
the projected disk.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.core.streams import generator
from harness.microgeometry.estimate import LIGHT


class Queries(NamedTuple):
    """Places, footprints and directions, with the reflectance found there."""

    u: Tensor
    """Centre of the footprint [N, 2] in uv; the tile is [0, 1)^2."""
    kernel: Tensor
    """Standard deviation [N] of the Gaussian footprint, in uv."""
    wi: Tensor
    """Direction to the camera [N, 2] on the disk."""
    wo: Tensor
    """Direction to the light [N, 2] on the disk."""
    f: Tensor
    """Estimate [N, 3] of the reflectance per steradian, without cosine."""


def truth(
    surface: Any,
    u: Tensor,
    kernel: Tensor,
    wi: Tensor,
    wo: Tensor,
    samples: int,
    seed: int,
    depth: int = 3,
    device: str = "cpu",
    light: float = LIGHT,
) -> Tensor:
    """Reflectance [N, 3] of the surface, linear Rec. 709, per steradian, without cosine.

    For each row, the mean over ``samples`` paths of the radiance towards ``wi`` [N, 2], at
    places spread around ``u`` [N, 2] by a Gaussian of deviation ``kernel`` [N], under distant
    light from ``wo`` [N, 2] that brings unit irradiance onto the reference plane (NeuMIP,
    eq. 1). A flat plane gives back its BRDF. ``light`` is the deviation in radians by which
    the light's direction is smoothed, ``depth`` the greatest number of bounces.

    An answer depends on its row's index, on ``seed`` (64 bits) and on the arguments, and not
    on the other rows, so that any prefix of a set of queries gets the same answers. Measured
    surfaces (``.btf``) have no depth and no light to smooth; ``samples`` is the number of
    footprint samples there.

    Raises:
        InputError: shapes that do not fit, directions that are not inside the disk, a
            negative footprint, a number of samples or bounces below one.
    """
    _check(u, kernel, wi, wo, samples, depth, light)
    if len(u) == 0:
        return u.new_empty(0, 3, dtype=torch.float32, device=device)
    with torch.inference_mode():
        f = surface.reflectance(
            u, kernel, wi, wo, samples=samples, seed=seed, depth=depth, device=device, light=light
        )
    return f.clone()


def energy(
    surface: Any,
    u: Tensor,
    kernel: Tensor,
    wi: Tensor,
    samples: int,
    seed: int,
    depth: int = 3,
    device: str = "cpu",
) -> tuple[Tensor, Tensor]:
    r"""Energies [N, 3] reflected towards ``wi`` [N, 2] under constant light: the integral

    .. math:: E(u, \sigma, \omega_i) = \int f(u, \sigma, \omega_i, \omega_o)\,
              d\omega_o^{\perp}

    over the disk, by ``samples`` (2 or more) paths each, and standard errors [N, 3]. A lossless
    surface has 1. Surfaces that trace no energies are asked at :func:`stratified` directions.
    """
    if callable(getattr(surface, "energy", None)):
        with torch.inference_mode():
            found = surface.energy(
                u, kernel, wi, samples=samples, seed=seed, depth=depth, device=device
            )
        return found[0].clone(), found[1].clone()
    side = max(2, 2 * round(samples**0.5 / 2))
    wo = stratified(len(u), side, seed).to(device)
    u, kernel, wi = (x.to(device).repeat_interleave(side * side, 0) for x in (u, kernel, wi))
    f = truth(surface, u, kernel, wi, wo.view(-1, 2), 1, seed, depth, device)
    return integral(f.view(-1, side * side, 3))


def stratified(n: int, side: int, seed: int) -> Tensor:
    """``n`` sets [n, side^2, 2] of directions on the disk, one in each cell of equal area."""
    random = generator(seed)
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    cell = torch.stack([x, y], -1).view(1, -1, 2)
    uniform = (cell + torch.rand(n, side * side, 2, generator=random)) / side
    return _inside(square_to_disk(uniform).view(-1, 2)).view(n, -1, 2)


def integral(f: Tensor) -> tuple[Tensor, Tensor]:
    """Integrals [N, C] over the disk of f [N, side^2, C] at :func:`stratified` directions.

    With standard errors [N, C] from differences of neighbouring cells, two and two: never too
    small in expectation, since the difference of two cells' means adds to them. ``side`` is even.
    """
    pairs = f.double().unflatten(1, (-1, 2))
    variance = (pairs[:, :, 0] - pairs[:, :, 1]).square().sum(1) / f.shape[1] ** 2
    return math.pi * f.double().mean(1).float(), math.pi * variance.sqrt().float()


def draw(
    surface: Any,
    n: int,
    seed: int,
    kernel: float | tuple[float, float] | None = None,
    samples: int = 2,
    depth: int = 3,
    device: str = "cpu",
    light: float = LIGHT,
) -> Queries:
    """``n`` random queries with their estimates, all on ``device``.

    Places are uniform in the tile, ``wi`` and ``wo`` uniform on the disk. ``kernel`` is a
    footprint for all, a range in which footprints are log-uniform, or None for half a texel,
    the finest that the surface has. Many queries of few samples teach more than few of many.
    """
    low, high = _range(surface, kernel)
    random = torch.rand(n, 7, generator=generator(seed))
    sigma = torch.full((n,), low)
    if high > low:
        sigma = low * (high / low) ** random[:, 6]
    parts = (random[:, :2], sigma, square_to_disk(random[:, 2:4]), square_to_disk(random[:, 4:6]))
    u, sigma, wi, wo = (x.to(device).contiguous() for x in parts)
    wi, wo = _inside(wi), _inside(wo)
    f = truth(surface, u, sigma, wi, wo, samples, seed, depth, device, light)
    return Queries(u, sigma, wi, wo, f)


def rays(surface: Any, n: int, seed: int, device: str = "cpu") -> tuple[Tensor, Tensor, Tensor]:
    """``n`` random rays to the camera, and where they leave the surface, all on ``device``.

    Where they pass the reference plane, u [N, 2], uniform in the tile; the directions ``wi``
    [N, 2], uniform on the disk; and the height [N] of the point that is seen, in widths of the
    tile. For surfaces that have heights: measured ones have none.
    """
    random = torch.rand(n, 4, generator=generator(seed))
    u, wi = random[:, :2], _inside(square_to_disk(random[:, 2:]))
    u, wi = u.to(device).contiguous(), wi.to(device).contiguous()
    with torch.inference_mode():
        found = surface.heights(u, wi, device=device)
    return u, wi, found.clone()


def _range(surface: Any, kernel: float | tuple[float, float] | None) -> tuple[float, float]:
    if kernel is None:
        return 0.5 / surface.resolution, 0.5 / surface.resolution
    low, high = kernel if isinstance(kernel, (tuple, list)) else (kernel, kernel)
    if not (0 <= low <= high and math.isfinite(high)) or (low == 0 < high):
        raise InputError(
            f"kernel: expected a footprint of at least 0, or a range (low, high) with"
            f" 0 < low <= high, got {kernel!r}"
        )
    return float(low), float(high)


def _inside(w: Tensor) -> Tensor:
    """Directions that rounding put on the rim, by one step of the floats off it."""
    outside = w.square().sum(1, keepdim=True) >= 1
    return torch.where(outside, w * (1 - 2**-22), w)


def _check(
    u: Tensor, kernel: Tensor, wi: Tensor, wo: Tensor, samples: int, depth: int, light: float
) -> None:
    n = len(u)
    for name, value, shape in (
        ("u", u, (n, 2)),
        ("kernel", kernel, (n,)),
        ("wi", wi, (n, 2)),
        ("wo", wo, (n, 2)),
    ):
        if tuple(value.shape) != shape:
            raise InputError(f"{name}: expected shape {list(shape)}, got {list(value.shape)}")
        if not torch.isfinite(value).all():
            raise InputError(f"{name}: expected finite numbers")
    for name, value in (("wi", wi), ("wo", wo)):
        if bool((value.square().sum(1) >= 1).any()):
            raise InputError(f"{name}: expected directions inside the unit disk")
    if bool((kernel < 0).any()):
        raise InputError("kernel: expected footprints of at least 0")
    if samples < 1 or depth < 1:
        raise InputError(f"expected at least 1 sample and 1 bounce, got {samples} and {depth}")
    if not light >= 0:
        raise InputError(f"light: expected a deviation of at least 0 radians, got {light}")
