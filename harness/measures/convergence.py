"""Error against samples per pixel and against seconds (NeuSample's Figure 8)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.compact import single
from harness.measures.images import checked, reference, too_slow
from harness.rendering.prepared import prepare


class Convergence(Measure):
    """Mean squared error of renders of 1, 2, 4, ... samples per pixel against a reference.

    The reference is Mitsuba's own render with light sampling (see
    :func:`~harness.measures.images.reference`); its own noise, known from its moments, is
    subtracted. The error is averaged over the pixels that show the material and over
    ``repeats`` independent renders, whose spread gives the interval. ``slope`` is that of
    log MSE against log spp: -1 for an unbiased estimator of finite variance. A method stops
    at the level that would take longer than ``max_seconds``. Seconds are medians over the
    repeats, their interval that of :func:`~harness.stats.intervals.median_interval`: from
    the fastest to the slowest where there are fewer than six.
    """

    name = "convergence"
    timed = True

    class Settings(BaseSettings):
        """``levels`` renders: spp = 1, 2, ..., 2^(levels - 1).

        A method that would need more than ``patience`` seconds for the first is not begun.
        """

        levels: int = 8
        repeats: int = 4
        resolution: int = 96
        reference_spp: int = 4096
        max_seconds: float = 5.0
        patience: float = 3600.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        settings = self.Settings(**jobs[0].settings)
        slow = [too_slow(j, settings.resolution, 1, settings.patience) for j in jobs]
        fit = [job for job, reason in zip(jobs, slow, strict=True) if not reason]
        found = iter(self._together(fit, settings, notify))
        return [Outcome("timeout", reason) if reason else next(found) for reason in slow]

    def _together(
        self, jobs: list[Job], settings: Settings, notify: Callable[[str], None]
    ) -> list[Outcome]:
        if not jobs:
            return []
        notify(f"{jobs[0].material.name}: reference image")
        truth = reference(jobs[0], settings.resolution, settings.reference_spp)
        prepared = [prepare(j.scene, j.material, j.method, settings.resolution) for j in jobs]
        found: list[list[_Level]] = [[] for _ in jobs]
        for level in range(settings.levels):
            spp = 2**level
            notify(f"convergence at {spp} spp, {len(jobs)} methods")
            for j, job in enumerate(jobs):
                last = np.median(found[j][-1].seconds) if found[j] else 0.0
                if 2 * last * settings.repeats > settings.max_seconds:
                    continue
                # Unmeasured, for the first render of a size allocates and may compile.
                prepared[j].render(spp, seed=level)
                mask = prepared[j].mask
                noise = truth.variance[mask].mean() / truth.spp
                errors, seconds = [], []
                for repeat in range(settings.repeats):
                    seed = 70_000 * (job.seed + 1) + 100 * level + repeat
                    rendered = checked(prepared[j].render(spp, seed), job)
                    errors.append(float(np.square(rendered.mean - truth.mean)[mask].mean() - noise))
                    seconds.append(rendered.seconds)
                found[j].append(_Level(spp, seconds, errors))
        return [_outcome(levels) for levels in found]


class _Level(NamedTuple):
    """Renders of ``spp`` samples: seconds and squared error of each repeat."""

    spp: int
    seconds: list[float]
    errors: list[float]


def _outcome(levels: list[_Level]) -> Outcome:
    return Outcome(
        arrays={
            "spp": np.array([level.spp for level in levels]),
            "all_seconds": single([level.seconds for level in levels]),
            "errors": single([level.errors for level in levels]),
        }
    )
