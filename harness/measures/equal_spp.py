"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from harness.core.protocol.errors import BudgetExceeded
from harness.core.record import Record
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, Batches, render_batches
from harness.measures.images import reference, too_slow
from harness.rendering.prepared import prepare
from harness.stats.intervals import mean_interval
from harness.stats.ztest import Agreement, agreement

DOUBT = 1e-3
"""p-value below which an image is looked at again; what says "biased" is lower."""
LONGER = 8
"""Times as many samples in the second look."""


class EqualSpp(Measure):
    """Variance of one sample of a pixel, averaged over the pixels that show the material.

    ``batches`` independent renders of ``spp`` samples per pixel each. Every render gives its
    own unbiased estimate of the variance, from first and second moments and without a
    reference; the interval is over batches. ``relative-variance`` is over the mean squared
    luminance. ``bias-p`` is the p-value of the mean image against a reference rendered by
    Mitsuba's own sampler with light sampling: small where they differ by more than noise, or
    where few samples missed what rare heavy ones carry, mean and variance alike. So an image
    that differs (``first-bias-p`` < ``DOUBT``) is rendered anew, and the reference too, with
    ``LONGER`` times the samples: all numbers are of those. Which is chosen by the first look
    alone: the second has not seen its samples, and a wrong density is all the plainer in more.
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

        def look(times: int, seed: int) -> tuple[Batches, Agreement]:
            done = render_batches(
                prepared,
                job,
                batches=settings.batches,
                spp=times * settings.spp,
                max_seconds=times * settings.max_seconds,
                seed=seed,
                notify=notify,
            )
            notify(f"{job.material.name}: reference image")
            truth = reference(job, settings.resolution, times * settings.reference_spp)
            variances = [done.variance_of_mean, truth.variance / truth.spp]
            return done, agreement([done.mean, truth.mean], variances, done.mask)[0]

        seed = 1000 * (job.seed + 1)
        done, found = look(1, seed)
        first_p = found.p_value
        if first_p < DOUBT:
            done, found = look(LONGER, seed + 500)
        mean, variance = done.mean, done.errors
        power = float(np.square(mean[done.mask]).mean())
        interval = mean_interval(variance)
        records = [
            Record("variance", *interval, "radiance^2"),
            Record("relative-variance", *(v / power for v in interval), "1"),
            Record("spp", float(done.spp), unit="1"),
            Record("bias", found.difference, unit="1"),
            Record("bias-z", found.global_score, unit="1"),
            Record("bias-p", found.p_value, unit="1"),
            Record("first-bias-p", first_p, unit="1"),
        ]
        arrays = {
            "batch_variance": variance,
            "mean": mean.astype(np.float32),
            "variance_of_mean": done.variance_of_mean.astype(np.float32),
            "mask": done.mask,
        }
        return Outcome(records=records, arrays=arrays, images={"mean": done.rgb})
