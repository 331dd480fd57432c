"""Error per sample, and agreement with a reference image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from harness.core.protocol.errors import BudgetExceeded
from harness.measures.base import Job, Measure, Outcome
from harness.measures.base import Settings as BaseSettings
from harness.measures.batches import LEAST, LEAST_SPP, Batches, render_batches
from harness.measures.compact import single
from harness.measures.images import too_slow
from harness.measures.precise import Precise, error_for, precise_reference
from harness.rendering import defensive
from harness.rendering.prepared import prepare
from harness.scenes.base import Scene
from harness.stats.blocks import SIZE, Blocks
from harness.stats.power import quantiles
from harness.stats.variance import Deviations
from harness.stats.ztest import agreement_of_blocks

DOUBT = 1e-3
"""p-value below which an image is rendered anew; what says "biased" is lower."""
LONGER = 8
"""Times as many samples in the second render."""
DETECT_CONSTANT, DETECT = 0.005, 0.01
"""Relative error of energy that the test of the mean is to find, in constant light and others."""
_SHARE = 0.5
"""Of the time to render in, what the renders by other samples get."""


class EqualSpp(Measure):
    """Variance of one sample of a pixel, averaged over the pixels that show the material.

    ``batches`` independent renders of ``spp`` samples per pixel each. Every render gives its
    own unbiased estimate of the variance, from first and second moments and without a
    reference. Of how estimates of one pixel deviate from each other the largest are kept
    (``deviations``; :class:`~harness.stats.variance.Deviations`), from which the tail of the
    estimate is told, and means over blocks of pixels (``block_variance``), for what methods have in
    common by common random numbers. Where an estimate is f L / p, the second moment is rendered
    once more with samples that are not all the method's (:mod:`harness.rendering.defensive`): what
    those renders find and the others do not is a tail that the method samples too rarely.

    ``relative-variance`` is over the mean squared luminance. ``bias-p`` is the p-value of the mean
    image against a reference (:func:`~harness.measures.precise.precise_reference`): small where
    they differ by more than noise, or where few samples missed what rare heavy ones carry, mean and
    variance alike. So an image that differs (``first-bias-p`` < ``DOUBT``) is rendered anew, and
    the reference too, with ``LONGER`` times the samples: all numbers are of those. Which is chosen
    by the first render alone: the second has not seen its samples, and a wrong density is all the
    plainer in more.

    Of both images the moments of blocks are kept (:class:`~harness.stats.blocks.Blocks`), in
    ``blocks`` and ``reference_blocks``, and those of the first render in ``first_...`` where there
    was a second.
    """

    name = "equal-spp"

    class Settings(BaseSettings):
        """``max_seconds`` ends a slow method's batches early, but never before the sixth.

        A method that would need more than ``patience`` seconds for six batches of the least
        two samples per pixel is not begun.

        ``detect`` is the uniform relative error of energy that the test of the mean is to find
        with 95 % power at level ``DOUBT``; by default 0.5 % in constant light and 1 % in others.
        For that up to ``longest`` times as many batches are rendered, for at most
        ``power_seconds``, and of the reference as many times ``reference_spp``, for at most
        ``reference_seconds``. ``longest: 1`` renders what the other settings say.
        """

        batches: int = 12
        spp: int = 64
        resolution: int = 96
        reference_spp: int = 4096
        max_seconds: float = 60.0
        patience: float = 3600.0
        detect: Annotated[float, Field(gt=0)] | None = None
        longest: Annotated[int, Field(ge=1)] = 32
        power_seconds: float = 1.0
        reference_seconds: float = 15.0

    def run(self, jobs: list[Job], notify: Callable[[str], None]) -> list[Outcome]:
        """See :class:`Measure`."""
        return [self._one(job, self.Settings(**job.settings), notify) for job in jobs]

    def _one(self, job: Job, settings: Settings, notify: Callable[[str], None]) -> Outcome:
        if reason := too_slow(job, settings.resolution, LEAST_SPP * LEAST, settings.patience):
            raise BudgetExceeded(reason)
        prepared = prepare(job.scene, job.material, job.method, settings.resolution)
        detect = _detect(job, settings)
        error = error_for(detect, quantiles(DOUBT))

        def render(times: int, seed: int) -> tuple[Batches, Precise]:
            """The batches and the reference."""
            notify(f"{job.material.name}: reference image")
            truth = precise_reference(
                job,
                settings.resolution,
                prepared.mask,
                least=times * settings.reference_spp,
                most=times * settings.longest * settings.reference_spp,
                error=error,
                seconds=settings.reference_seconds,
            )
            done = render_batches(
                prepared,
                job,
                batches=settings.batches,
                spp=times * settings.spp,
                max_seconds=times * settings.max_seconds,
                seed=seed,
                notify=notify,
                more=lambda done: _error(done) > error,
                most=settings.longest * settings.batches,
                more_seconds=settings.power_seconds,
            )
            return done, truth

        def blocks(done: Batches, truth: Precise) -> list[Blocks]:
            return [
                Blocks.of(done.mean, done.variance_of_mean, done.mask),
                Blocks.of(truth.mean, truth.variance, done.mask),
            ]

        seed = 1000 * (job.seed + 1)
        done, truth = render(1, seed)
        pair = blocks(done, truth)
        arrays: dict[str, NDArray] = {}
        if agreement_of_blocks(pair)[0].p_value < DOUBT:
            arrays["first_blocks"], arrays["first_reference_blocks"] = (b.packed() for b in pair)
            done, truth = render(LONGER, seed + 500)
            pair = blocks(done, truth)
        arrays["blocks"], arrays["reference_blocks"] = (b.packed() for b in pair)
        arrays |= {
            "pixels": pair[0].pixels.astype(np.uint16),
            "batch_variance": single(done.errors),
            "spp": np.array(done.spp),
            "batch_spp": np.array(done.passes[0].spp),
            "block_variance": single(_by_block(done)),
            "reference_spp": np.array(truth.spp),
            "detect": np.array(detect),
        }
        several = len(done.passes) > 1
        if several:  # of one render alone nothing tells a deviation
            arrays["deviations"] = Deviations.of(done.variances).packed()
        if several and defensive.applies(job.method, job.scene):
            arrays |= _defensive(job, done, settings, notify)
        documents = {"reference": {"sampler": truth.sampler}}
        return Outcome(arrays=arrays, documents=documents, images={"mean": done.rgb})


def _detect(job: Job, settings: EqualSpp.Settings) -> float:
    if settings.detect is not None:
        return settings.detect
    return DETECT_CONSTANT if in_constant_light(job.scene) else DETECT


def in_constant_light(scene: object) -> bool:
    """Whether all light there is comes alike from everywhere."""
    alone = isinstance(scene, Scene) and scene.lights == {"environment"}
    return alone and isinstance(scene.environment, float | int)


def _error(done: Batches) -> float:
    """Standard error of the mean over the mask, over that mean."""
    variance = done.variance_of_mean[done.mask].sum()
    return float(np.sqrt(max(variance, 0.0)) / abs(done.mean[done.mask].sum()))


def _by_block(done: Batches) -> NDArray:
    """Mean variance over the pixels of each block that has some [B, blocks]."""
    y, x = np.nonzero(done.mask)
    block = (y // SIZE) * -(-done.mask.shape[1] // SIZE) + x // SIZE
    _, block = np.unique(block, return_inverse=True)
    pixels = np.bincount(block)
    return np.array([np.bincount(block, row) / pixels for row in done.variances])


def _defensive(
    job: Job, done: Batches, settings: EqualSpp.Settings, notify: Callable[[str], None]
) -> dict[str, NDArray]:
    """The variance again, from second moments by other samples, and the squares of the means.

    Not above zero where little variance is left between two large moments.
    """
    other = replace(job, method=defensive.second_moment(job.method))
    prepared = prepare(job.scene, job.material, other.method, settings.resolution)
    again = render_batches(
        prepared,
        other,
        batches=settings.batches,
        spp=done.passes[0].spp,
        max_seconds=_SHARE * settings.max_seconds,
        seed=1000 * (job.seed + 1) + 700,
        notify=notify,
        label="by other samples",
    )
    second = np.array(
        [(p.variance * (1 - 1 / p.spp) + np.square(p.mean))[done.mask] for p in again.passes]
    )
    square = done.squared_mean
    means = np.array([np.square(p.mean[done.mask]).mean() for p in done.passes])
    return {
        "other_second": single(second.mean(1)),
        "other_deviations": Deviations.of(second).packed(),
        "squared_mean": np.array(square.mean()),
        "squared_mean_error": np.array(means.std(ddof=1) / np.sqrt(len(means))),
        "other_spp": np.array(again.spp),
    }
