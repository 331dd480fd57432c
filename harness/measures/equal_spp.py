"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from harness.measures.base import Job, Measure, Outcome, Record
from harness.measures.base import Settings as BaseSettings
from harness.measures.images import checked, reference, too_slow
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
        if reason := too_slow(job, settings.resolution, 2 * 6, settings.patience):
            raise BudgetExceeded(reason)
        prepared = prepare(job.scene, job.material, job.method, settings.resolution)
        mask = prepared.mask
        notify(f"{job.method.name}: warm-up")
        checked(prepared.render(2, job.seed + 98), job)
        once = checked(prepared.render(2, job.seed + 99), job)
        # A slow method takes fewer samples a batch, rather than fewer batches.
        affordable = settings.max_seconds / settings.batches / (once.seconds / 2)
        spp = int(min(settings.spp, max(2, affordable)))
        passes, spent = [], 0.0
        for batch in range(settings.batches):
            notify(f"{job.method.name}: batch {batch + 1} of {settings.batches} at {spp} spp")
            passes.append(checked(prepared.render(spp, 1000 * (job.seed + 1) + batch), job))
            spent += passes[-1].seconds
            if spent > settings.max_seconds and batch >= 5:
                break
        variance = np.array([p.variance[mask].mean() for p in passes])
        mean = np.mean([p.mean for p in passes], 0)
        pixel_variance = np.mean([p.variance for p in passes], 0) / (spp * len(passes))
        power = float(np.square(mean[mask]).mean())
        interval = mean_interval(variance)
        records = [
            Record("variance", *interval, "radiance^2"),
            Record("relative-variance", *(v / power for v in interval), "1"),
            Record("spp", float(spp * len(passes)), unit="1"),
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
        rgb = np.mean([p.rgb for p in passes], 0)
        return Outcome(records=records, arrays=arrays, images={"mean": rgb})
