"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from harness.measures.base import Job, Measure, Outcome, Record
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, render_batches
from harness.measures.images import reference, too_slow
from harness.protocol import BudgetExceeded
from harness.rendering.prepared import prepare
from harness.stats.intervals import mean_interval
from harness.stats.ztest import agreement


class EqualSpp(Measure):
    """Variance of one sample of a pixel, averaged over the pixels that show the material.

    ``batches`` independent renders of ``spp`` samples per pixel each. Every render gives its
    own unbiased estimate of the variance, from first and second moments and without a
    reference; the interval is over batches. ``relative-variance`` is over the mean squared
    luminance. ``bias-p`` is the p-value of the mean image against a reference rendered by
    Mitsuba's own sampler with light sampling: small where they differ by more than noise.
    """

    name = "equal-spp"

    class Settings(BaseSettings):
        """``max_seconds`` ends a slow method's batches early, but never before the sixth.

        A method that would need more than ``patience`` seconds for six batches of the least
        two samples per pixel is not begun.
        """

        batches: int = 12
        spp: int = 64
        resolution: int = 96
        reference_spp: int = 4096
        max_seconds: float = 60.0
        patience: float = 3600.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        if reason := too_slow(job, settings.resolution, LEAST_SPP * LEAST, settings.patience):
            raise BudgetExceeded(reason)
        prepared = prepare(job.scene, job.material, job.method, settings.resolution)
        done = render_batches(
            prepared,
            job,
            batches=settings.batches,
            spp=settings.spp,
            max_seconds=settings.max_seconds,
            seed=1000 * (job.seed + 1),
            notify=notify,
        )
        mask, mean, variance = done.mask, done.mean, done.errors
        pixel_variance = done.variance_of_mean
        power = float(np.square(mean[mask]).mean())
        interval = mean_interval(variance)
        records = [
            Record("variance", *interval, "radiance^2"),
            Record("relative-variance", *(v / power for v in interval), "1"),
            Record("spp", float(done.spp), unit="1"),
        ]
        arrays = {
            "batch_variance": variance,
            "mean": mean.astype(np.float32),
            "variance_of_mean": pixel_variance.astype(np.float32),
            "mask": mask,
        }
        notify(f"{job.material.name}: reference image")
        truth = reference(job, settings.resolution, settings.reference_spp)
        found = agreement([mean, truth.mean], [pixel_variance, truth.variance / truth.spp], mask)[0]
        records += [
            Record("bias", found.difference, unit="1"),
            Record("bias-z", found.global_score, unit="1"),
            Record("bias-p", found.p_value, unit="1"),
        ]
        return Outcome(records=records, arrays=arrays, images={"mean": done.rgb})
