"""Renders to be timed: one method in one scene, warmed up, its samples filling a time slice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from harness.measures.base import Job
from harness.measures.images import checked
from harness.measures.timing import Contender, RoundSettings, settle
from harness.rendering.prepared import Prepared, prepare


class RenderSettings(RoundSettings):
    """``slice_seconds`` of rendering per method and round, or exactly ``spp`` samples per pixel.

    A method that would need more than ``patience`` seconds for its rounds is not begun.
    """

    slice_seconds: float = 0.2
    spp: int | None = None
    resolution: int = 96
    patience: float = 3600.0


@dataclass
class Entrant:
    """One method's renders of a scene, ``spp`` samples per pixel in each."""

    job: Job
    prepared: Prepared
    spp: int = 2
    errors: list[float] = field(default_factory=list)
    """Of every timed render: variance of one sample, averaged over the pixels that count."""
    variances: list[NDArray] = field(default_factory=list)
    """The same of each pixel that counts [P]."""
    stream: int = 0

    def once(self, number: int) -> float:
        """Seconds of a render in round ``number``; its random numbers are no other render's.

        Nor those of another ``stream``, up to 600 renders: renders of different methods are
        then independent, which their intervals take them to be.
        """
        seed = 5000 * (self.job.seed + 1) + 600_000 * self.stream + len(self.errors)
        rendered = checked(self.prepared.render(self.spp, seed), self.job)
        self.errors.append(rendered.error(self.prepared.mask))
        self.variances.append(rendered.variance[self.prepared.mask].astype(np.float32))
        return rendered.seconds

    def contender(self, rival: int | None, slices: int = 0) -> Contender:
        """Seconds per sample per pixel."""
        return Contender(f"{self.job.method.name} render", self.once, self.spp, rival, slices)


def enter(
    job: Job, settings: RenderSettings, notify: Callable[[str], None], stream: int = 0
) -> Entrant:
    """Compile, fill caches, and find the samples that fill one slice."""
    notify(f"{job.method.name}: warm-up")
    prepared = prepare(job.scene, job.material, job.method, settings.resolution)
    entrant = Entrant(job, prepared, stream=stream)
    _ = entrant.prepared.mask  # made now, not in the first round
    spent, seeds = 0.0, iter(range(77, 10**6))

    def once() -> float:
        nonlocal spent
        rendered = checked(entrant.prepared.render(entrant.spp, next(seeds)), job)
        spent += rendered.seconds
        return rendered.seconds

    if settings.spp is not None:
        entrant.spp = settings.spp
        settle(once, settings)
        return entrant
    while True:
        seconds = settle(once, settings, spent=spent)
        wanted = int(settings.slice_seconds / (seconds / entrant.spp))
        grow = wanted > 1.5 * entrant.spp
        # At least two samples a pixel: one has no variance. At most eight times as many at once:
        # a launch costs the same for all of them, so few samples seem to cost more than they do.
        entrant.spp = max(2, min(wanted, 8 * entrant.spp))
        if not grow:
            return entrant
