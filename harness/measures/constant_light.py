"""The variance of f/p under constant light, as an integral."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from harness.core.protocol.disk import disk_to_square, inside_disk, luminance, square_to_disk
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.materials.families.walks import WalkFamily
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.densities import checked_density
from harness.measures.equal_spp import in_constant_light
from harness.rendering import defensive, seen
from harness.rendering.broad import Broad
from harness.rendering.prepared import prepare

_ROWS = 1 << 19


class ConstantLight(Measure):
    r"""Under constant light L the variance of one sample of a pixel is an integral.

    With c a random point of the pixel, A(c) its albedo and p the method's density there,

    .. math:: \frac{V}{L^2} = E_c\!\left[\int \frac{f^2}{p} - A(c)^2\right] + Var_c[A(c)] .

    The second part is the footprint's: no sampler changes it. Two points of every pixel of the
    render's mask, the pixels' own in a render's way; at each the inner integral in two passes.
    The first looks at f and f^2/p in ``grid``^2 equal cells of the disk. The second has ``points``
    directions from a mixture of the method, of a :class:`~harness.rendering.broad.Broad` sampler
    that goes to narrow peaks, and of the cells, in proportion to what f and f^2/p had in them:
    unbiased wherever the method or the cells missed something. Kept for both points of every pixel:
    ``sampler`` [2, P], the inner integral less A^2, and ``albedo`` [2, 2, P], at each point by two
    halves of the directions, whose products have no noise squared; all luminance.
    """

    name = "constant-light"

    class Settings(BaseSettings):
        """``points`` a multiple of eight; ``pixels`` of the mask at most, chosen evenly."""

        resolution: int = 96
        grid: Annotated[int, Field(ge=2)] = 16
        points: Annotated[int, Field(ge=8, multiple_of=8)] = 128
        pixels: Annotated[int, Field(ge=2)] = 4096

    @classmethod
    def why_not(cls, scene: Any) -> str:
        """See :meth:`Measure.why_not`."""
        constant = in_constant_light(scene)
        return "" if constant else f"scene '{scene.name}' has light that is not constant"

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        if why := self.why_not(job.scene):
            raise Unsupported(why)
        if not defensive.applies(job.method, job.scene):
            raise Unsupported(f"an estimate of {job.method.name} is not f / p of one bounce")
        if isinstance(job.material, WalkFamily):
            raise Unsupported("f is a mean over random walks, whose noise is part of a weight")
        prepared = prepare(job.scene, job.material, job.method, settings.resolution)
        pixels = np.argwhere(prepared.mask)
        if len(pixels) > settings.pixels:
            pixels = pixels[np.linspace(0, len(pixels) - 1, settings.pixels).astype(int)]
        sampler, albedo = [], []
        for point in range(2):
            condition = seen.conditions(prepared, pixels, 31 + point)
            notify(f"{job.method.name}: {len(pixels)} integrals, {point + 1} of 2")
            found = integrals(job.method, job.material, condition, settings, job.generator)
            sampler.append(found[0])
            albedo.append(found[1])
        return Outcome(
            arrays={
                "sampler": single(np.stack(sampler)),
                "albedo": single(np.moveaxis(np.stack(albedo), 2, 1)),
                "radiance": np.array(float(job.scene.environment)),
            }
        )


def integrals(
    method: Method,
    material: Material,
    condition: Tensor,
    settings: ConstantLight.Settings,
    generator: torch.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Of each condition [K, C]: variance of one weight [K], albedo twice [K, 2]; all unbiased."""
    step = max(1, _ROWS // max(settings.grid**2, settings.points))
    parts = [
        _some(method, material, rows, settings, generator) for rows in torch.split(condition, step)
    ]
    variance, albedo = (torch.cat(each).cpu().numpy() for each in zip(*parts, strict=True))
    return variance, albedo


def _some(
    method: Method,
    material: Material,
    rows: Tensor,
    settings: ConstantLight.Settings,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    share = _shares(method, material, rows, settings, generator)
    broad, n, cells = Broad(), settings.points, settings.grid**2

    u = torch.rand(len(rows), n, 4, generator=generator).to(rows.device)
    many = rows.repeat_interleave(n, 0)
    flat = u.reshape(-1, 4)
    # In turn: the method, the broad one, the cells twice; and every kind in both halves below.
    kind = torch.arange(len(flat), device=rows.device) // 2 % 4
    own = method.sample(many, flat[:, :3]).wo
    near = broad.sample(many, flat[:, :3]).wo
    drawn = torch.searchsorted(share.cumsum(1), u[..., 3].contiguous()).clamp(max=cells - 1)
    even = _in_cells(drawn.reshape(-1), flat[:, :2], settings.grid)
    wo = torch.where((kind == 0)[:, None], own, torch.where((kind == 1)[:, None], near, even))
    inside = inside_disk(wo)
    place = torch.where(inside[:, None], wo, 0)
    p = checked_density(method.pdf(many, place), method).double()
    of_cells = torch.gather(share, 1, _cell_of(place, settings.grid).view(len(rows), n))
    q = p / 4 + broad.pdf(many, place).double() / 4
    q = q + of_cells.reshape(-1).double() * cells / math.pi / 2
    f = luminance(material.eval(many, place)).double()
    # Where p = 0 the method never goes, and where q = 0 nobody does.
    sampled = inside & (p > 0)
    w = torch.where(sampled, f / torch.where(sampled, p, 1), 0)
    once = torch.where(sampled, w * p / q, 0).view(len(rows), n)
    twice = torch.where(sampled, w * w * p / q, 0).view(len(rows), n)
    # A square of the albedo by two halves that share no direction: unbiased.
    first, second = once[:, ::2].mean(1), once[:, 1::2].mean(1)
    return twice.mean(1) - first * second, torch.stack([first, second], 1)


def _shares(
    method: Method,
    material: Material,
    rows: Tensor,
    settings: ConstantLight.Settings,
    generator: torch.Generator,
) -> Tensor:
    """Of each cell [K, cells], by one direction in it: half by f, half by f^2 / p."""
    cells = settings.grid**2
    u = torch.rand(len(rows) * cells, 2, generator=generator).to(rows.device)
    index = torch.arange(cells, device=rows.device).repeat(len(rows))
    wo, many = _in_cells(index, u, settings.grid), rows.repeat_interleave(cells, 0)
    f = luminance(material.eval(many, wo)).double().abs()
    p = checked_density(method.pdf(many, wo), method).double()
    square = torch.where(p > 0, f * f / torch.where(p > 0, p, 1), 0)
    parts = [v.view(len(rows), cells) for v in (f, square)]
    total = [v.sum(1, keepdim=True) for v in parts]
    # A tenth evenly: one direction a cell is no proof of an empty one.
    even = torch.full_like(parts[0], 1 / cells)
    shares = [
        torch.where(t > 0, v / torch.where(t > 0, t, 1), even)
        for v, t in zip(parts, total, strict=True)
    ]
    return 0.1 * even + 0.45 * (shares[0] + shares[1])


def _in_cells(index: Tensor, u: Tensor, grid: int) -> Tensor:
    """Points [N, 2] of the disk, uniform in cells ``index`` [N] of the square it is mapped from."""
    corner = torch.stack([index % grid, index // grid], 1)
    return square_to_disk((corner + u) / grid)


def _cell_of(wo: Tensor, grid: int) -> Tensor:
    """Index [N] of the cell of each point of the disk."""
    at = (disk_to_square(wo) * grid).long().clamp(0, grid - 1)
    return at[:, 0] + grid * at[:, 1]
