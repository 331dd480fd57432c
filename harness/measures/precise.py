"""Images long enough that a test of their mean has power: the reference, and more batches."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.core import registry
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.method import Method
from harness.measures.base import Job
from harness.measures.images import KEPT, checked
from harness.rendering.broad import Broad
from harness.rendering.prepared import Prepared, prepare, prepare_native

PILOT = 32
"""Samples per pixel by which samplers are compared."""
CHUNK = 256
"""Samples per pixel between two looks at the clock."""
SEED = 424242


@dataclass(frozen=True)
class Precise:
    """A mean luminance image [H, W], the variance of each pixel's mean, and how it came about."""

    mean: NDArray
    variance: NDArray
    spp: int
    sampler: str
    seconds: float

    def relative_error(self, mask: NDArray) -> float:
        """Standard error of the mean over ``mask``, over that mean."""
        return float(np.sqrt(self.variance[mask].sum()) / abs(self.mean[mask].sum()))


_kept: dict[tuple, tuple[Precise, Any, Any]] = {}


def precise_reference(
    job: Job, resolution: int, mask: NDArray, *, least: int, most: int, error: float, seconds: float
) -> Precise:
    """An image of the job's material in its scene, made once per process; independent of the job.

    Candidates are Mitsuba's own sampler, where the material is a Mitsuba BSDF, the cosine's, and a
    :class:`~harness.rendering.broad.Broad` one, all with light sampling; that of least variance in
    a short render is taken. ``least`` to ``most`` samples per pixel: until the relative standard
    error of the mean over ``mask`` is below ``error``, or ``seconds`` are over.
    """
    key = (id(job.material), id(job.scene), resolution, least, most, error, seconds)
    if key not in _kept:
        while len(_kept) >= KEPT:
            del _kept[next(iter(_kept))]
        # With the two objects: as long as they are kept, their ids are not given out again.
        made = _rendered(job, resolution, mask, least, most, error, seconds)
        _kept[key] = (made, job.material, job.scene)
    return _kept[key][0]


def _rendered(
    job: Job, resolution: int, mask: NDArray, least: int, most: int, error: float, limit: float
) -> Precise:
    pilots = {
        name: (prepared, checked(prepared.render(PILOT, SEED - 1 - k), job).error(mask))
        for k, (name, prepared) in enumerate(_candidates(job, resolution).items())
    }
    sampler = min(pilots, key=lambda name: pilots[name][1])
    prepared = pilots[sampler][0]
    start, spp, mean, variance = time.perf_counter(), 0, 0.0, 0.0
    while True:
        count = min(max(least, CHUNK) if spp == 0 else CHUNK, most - spp)
        part = checked(prepared.render(count, SEED + spp), job)
        mean, variance = mean + count * part.mean, variance + count * part.variance
        spp += count
        spent = time.perf_counter() - start
        found = Precise(mean / spp, variance / spp / spp, spp, sampler, spent)
        if spp >= most or spent > limit or found.relative_error(mask) < error:
            return found


def _candidates(job: Job, resolution: int) -> dict[str, Prepared]:
    found = {}
    try:
        native = prepare_native(job.scene, job.material, resolution)
        # A symbolic call would be compiled with every BSDF alive in it, the one under test
        # included, which is to take no part.
        native.symbolic = False
        found["native"] = native
    except Unsupported:
        pass
    for method in (registry.make("cosine"), Broad()):
        method.bind(job.material)
        found[method.name] = _with_lights(job, method, resolution)
    return found


def _with_lights(job: Job, method: Method, resolution: int) -> Prepared:
    return prepare(job.scene, job.material, method, resolution, "mis")


def error_for(detect: float, quantiles: float) -> float:
    """Relative standard error of each of two images for a difference ``detect`` to be found.

    ``quantiles`` is the sum of the normal quantiles of level and power
    (:func:`harness.stats.power.quantiles`); the two errors add in squares.
    """
    return detect / quantiles / 2**0.5
