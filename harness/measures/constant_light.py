"""The variance of f/p under constant light, as an integral."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from harness.core.protocol.disk import inside_disk, luminance
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.method import Method
from harness.core.streams import generator
from harness.materials.families.walks import WalkFamily
from harness.measures import light_cells as cells
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.densities import checked_density
from harness.measures.equal_spp import in_constant_light
from harness.measures.light_points import PEAKS, Half, draw
from harness.rendering import defensive
from harness.rendering.prepared import prepare
from harness.stats.variance import Deviations

OWN = 2
"""Directions of the method at each row."""
GROUPS = 256
"""Groups of pixels whose means are kept."""
_LEAST = 1e-3
"""Density per area of the disk below which where a method goes is no guide to where to look."""


class ConstantLight(Measure):
    r"""Under constant light L the variance of one sample of a pixel is an integral.

    With c a random point of the pixel, A(c) its albedo, p the method's density there per area of
    the projected disk and l(c) the share of samples that are off it,

    .. math:: \frac{V}{L^2} = E_c[S(c)] + Var_c[A(c)], \qquad
              S(c) = \int \frac{f^2}{p} - A^2 = \int \frac{(f - A p)^2}{p} + A^2 l .

    The second part is the footprint's: no sampler changes it. The last form of S has no difference
    of large numbers, and for any number a in place of A it is S(c) + (A - a)^2.

    All pixels of the render's mask, and of more than ``pixels`` one in each of so many runs, are
    measured twice, by two halves that share nothing. Where points and directions are dense f alone
    decides, so that they are the same for all methods (:mod:`harness.measures.light_points`):
    ``points`` a pixel. With each method come ``OWN`` directions of its own at every row c, and a
    third as many as ``points`` where its density at the peaks of f says that f^2/p is large. A
    direction of all three counts one over their common rate,

    .. math:: \int h \approx \sum_i \frac{h(\omega_i)}{r + r' + OWN\,p}(\omega_i)

    with r of the common ones and r' of the last kind, per area of the disk (the balance heuristic).
    It is unbiased wherever one of the three missed something.

    Kept of both halves: the largest ``deviations`` of pixels between them
    (:class:`~harness.stats.variance.Deviations`), and by groups of ``pixels`` [G] the means of S,
    ``sampler`` [2, G], and of the footprint's part, ``footprint`` [2, G]; ``energy`` is the mean
    of squared means of pixels. All are of luminance, for L = 1.
    """

    name = "constant-light"

    class Settings(BaseSettings):
        """``points`` are directions of a pixel on average, ``pixels`` at most so many."""

        resolution: int = 96
        points: Annotated[int, Field(ge=8)] = 96
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
        halves = _halves(job, settings, notify)
        notify(f"{job.method.name}: {sum(len(half.condition) for half in halves)} integrals")
        arrays = integrated(job.method, halves, settings.points, job.generator.initial_seed())
        return Outcome(arrays=arrays | {"radiance": np.array(float(job.scene.environment))})


def integrated(method: Method, halves: list[Half], points: int, seed: int) -> dict[str, NDArray]:
    """What :class:`ConstantLight` keeps, for light of radiance one."""
    sampler, footprint, energy = [], [], []
    for k, half in enumerate(halves):
        extra = points * half.pixels // 6
        sampler.append(variances(method, half, extra, generator(4 * seed + k)))
        part, square = footprints(half)
        footprint.append(part)
        energy.append(square.mean())
    both = np.stack(sampler), np.stack(footprint)
    start = np.unique(np.linspace(0, halves[0].pixels, GROUPS + 1).astype(int))
    means = [np.add.reduceat(x, start[:-1], 1) / np.diff(start) for x in both]
    return {
        "sampler": single(means[0]),
        "footprint": single(means[1]),
        "pixels": np.diff(start).astype(np.uint16),
        "deviations": single(Deviations.of(both[0] + both[1]).packed()),
        "energy": np.array(float(np.mean(energy))),
    }


def variances(method: Method, half: Half, extra: int, stream: torch.Generator) -> NDArray:
    """Mean over the rows of each pixel [P] of S, unbiased; ``extra`` directions where f^2/p is."""
    device, many = half.condition.device, len(half.condition)
    every = torch.arange(many, device=device)
    table = extra * _where_large(method, half)
    at = cells.stratified(table, stream)
    row, leaf = at // cells.LEAVES, at % cells.LEAVES
    wo = half.leaves.points(row, leaf, torch.rand(len(row), 2, generator=stream).to(device))

    owner = every.repeat_interleave(OWN)
    u = torch.rand(len(owner), 3, generator=stream).to(device)
    own = method.sample(half.condition[owner], u).wo
    inside = inside_disk(own)
    lost = 1 - inside.view(many, OWN).double().mean(1)

    row, wo = torch.cat([row, owner[inside]]), torch.cat([wo, own[inside]])
    # By row: a method that tabulates p at a condition does so once.
    order = torch.cat([half.row, row]).argsort(stable=True)
    f = luminance(method.material.eval(half.condition[row], wo)).double()
    f = torch.cat([half.f, f])[order]
    new = half.leaves.at(row, wo)
    rate = torch.cat([half.rate, half.rates(row, new, wo)])[order]
    row, wo = torch.cat([half.row, row])[order], torch.cat([half.wo, wo])[order]
    p = checked_density(method.pdf(half.condition[row], wo), method).double()
    rate = rate + OWN * p
    leaf = half.leaves.at(row, wo)
    rate = rate + (table[row, leaf] / cells.areas(device)[leaf]).double()

    first, second = half.albedo
    about = (first + second) / 2
    # Where p = 0 the method never goes, and its estimate has nothing of f there.
    reached = p > 0
    h = torch.where(reached, (f - about[row] * p).square() / torch.where(reached, p, 1) / rate, 0)
    found = torch.zeros(many, dtype=torch.float64, device=device).index_add_(0, row, h)
    # Of two independent estimates: the variance of their mean is what a = A would not have.
    found = found + about.square() * lost - (first - second).square() / 4
    return _by_pixel(half, found * half.share)


def footprints(half: Half) -> tuple[NDArray, NDArray]:
    """Variance of the albedo within each pixel [P], and the square of its mean [P]; unbiased."""
    first, second = half.albedo
    square = _by_pixel(half, first * second * half.share)
    mean = half.albedo.mean(0) * half.share * 2
    one, other = (_by_pixel(half, torch.where(half.set == k, mean, 0)) for k in (0, 1))
    # Of two sets that share no point: no noise is squared.
    return square - one * other, one * other


def _where_large(method: Method, half: Half) -> Tensor:
    """About f^2/p of each row and leaf [N, LEAVES], by pixels alike, with the sum one.

    By one density at each of the row's peaks, and as if p were f / A elsewhere.
    """
    area = cells.areas(half.condition.device)
    owner = torch.arange(len(half.condition), device=area.device).repeat_interleave(PEAKS)
    p = method.pdf(half.condition[owner], half.peak_wo.flatten(0, 1))
    p = checked_density(p, method).clamp(min=_LEAST).view(-1, PEAKS)
    inside = half.value * area
    large = inside * inside.sum(1, keepdim=True)
    at_peaks = half.peak_f.square() / p * area[half.peak_leaf]
    large = large.scatter(1, half.peak_leaf, at_peaks.to(large)) * half.share.float()[:, None]
    total = large.sum(dtype=torch.float64)
    return (large / total).float() if total > 0 else large


def _by_pixel(half: Half, values: Tensor) -> NDArray:
    zero = torch.zeros(half.pixels, dtype=torch.float64, device=values.device)
    return zero.index_add_(0, half.pixel, values).cpu().numpy()


_kept: dict[tuple, tuple[list[Half], Any, Any]] = {}


def _halves(
    job: Job, settings: ConstantLight.Settings, notify: Callable[[str], None]
) -> list[Half]:
    """Two halves of the job's material in its scene, made once for all its methods."""
    seed = job.generator.initial_seed()
    key = (id(job.material), id(job.scene), seed, *settings.model_dump().values())
    if key not in _kept:
        _kept.clear()
        notify(f"{job.material.name}: where f is")
        prepared = prepare(job.scene, job.material, job.method, settings.resolution)
        pixels = np.argwhere(prepared.mask)
        made = []
        for k in range(2):
            some = _some(pixels, settings.pixels, np.random.default_rng([seed, k]))
            directions = settings.points * len(some) // 2
            made.append(draw(prepared, job.material, some, directions, 4 * seed + 2 + k))
        # With the two objects: as long as they are kept, their ids are not given out again.
        _kept[key] = (made, job.material, job.scene)
    return _kept[key][0]


def _some(pixels: NDArray, most: int, rng: np.random.Generator) -> NDArray:
    """All pixels, or a random one of each of ``most`` runs of equal length."""
    if len(pixels) <= most:
        return pixels
    at = (np.arange(most) + rng.random(most)) * (len(pixels) / most)
    return pixels[at.astype(int)]
