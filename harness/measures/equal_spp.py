"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import BudgetExceeded
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, Batches, render_batches
from harness.measures.compact import single
from harness.measures.images import reference, too_slow
from harness.rendering.prepared import prepare
from harness.stats.blocks import Blocks
from harness.stats.ztest import agreement_of_blocks

DOUBT = 1e-3
"""p-value below which an image is rendered anew; what says "biased" is lower."""
LONGER = 8
"""Times as many samples in the second render."""


class EqualSpp(Measure):
    """Variance of one sample of a pixel, averaged over the pixels that show the material.

    ``batches`` independent renders of ``spp`` samples per pixel each. Every render gives its
    own unbiased estimate of the variance, from first and second moments and without a
    reference; the interval is over batches. ``relative-variance`` is over the mean squared
    luminance. ``bias-p`` is the p-value of the mean image against a reference rendered by
    Mitsuba's own sampler with light sampling: small where they differ by more than noise, or
    where few samples missed what rare heavy ones carry, mean and variance alike. So an image
    that differs (``first-bias-p`` < ``DOUBT``) is rendered anew, and the reference too, with
    ``LONGER`` times the samples: all numbers are of those. Which is chosen by the first render
    alone: the second has not seen its samples, and a wrong density is all the plainer in more.

    Of both images the moments of blocks are kept (:class:`~harness.stats.blocks.Blocks`), in
    ``blocks`` and ``reference_blocks``, and those of the first render in ``first_...`` where there
    was a second.
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

        def render(times: int, seed: int) -> tuple[Batches, list[Blocks]]:
            """The batches, and the blocks of their mean and of the reference."""
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
            return done, [
                Blocks.of(done.mean, done.variance_of_mean, done.mask),
                Blocks.of(truth.mean, truth.variance / truth.spp, done.mask),
            ]

        seed = 1000 * (job.seed + 1)
        done, blocks = render(1, seed)
        arrays: dict[str, NDArray] = {}
        if agreement_of_blocks(blocks)[0].p_value < DOUBT:
            arrays["first_blocks"], arrays["first_reference_blocks"] = (b.packed() for b in blocks)
            done, blocks = render(LONGER, seed + 500)
        arrays["blocks"], arrays["reference_blocks"] = (b.packed() for b in blocks)
        arrays |= {
            "pixels": blocks[0].pixels.astype(np.uint16),
            "batch_variance": single(done.errors),
            "spp": np.array(done.spp),
        }
        return Outcome(arrays=arrays, images={"mean": done.rgb})
