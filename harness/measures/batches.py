"""Independent renders of one method, as several measures take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from harness.measures.base import Job
from harness.measures.images import checked
from harness.rendering.passes import Pass
from harness.rendering.prepared import Prepared
from harness.stats.moments import variance_from_batches

LEAST = 6
"""Batches that are always rendered: fewer give no interval of 95 %."""
LEAST_SPP = 2
"""One sample of a pixel has no variance."""


@dataclass(frozen=True)
class Batches:
    """B finished renders with as many samples per pixel each; luminance in radiance."""

    passes: list[Pass]
    mask: NDArray[np.bool_]

    @property
    def spp(self) -> int:
        """Samples per pixel of all batches together."""
        return sum(p.spp for p in self.passes)

    @property
    def mean(self) -> NDArray:
        """Mean luminance [H, W]."""
        return np.mean([p.mean for p in self.passes], 0)

    @property
    def rgb(self) -> NDArray:
        """Mean radiance [H, W, 3]."""
        return np.mean([p.rgb for p in self.passes], 0)

    @property
    def errors(self) -> NDArray:
        """Variance of one sample, averaged over the mask, by each batch alone [B]."""
        return np.array([p.error(self.mask) for p in self.passes])

    @property
    def variances(self) -> NDArray:
        """Variance of one sample of each pixel of the mask, by each batch alone [B, P]."""
        return np.array([p.variance[self.mask] for p in self.passes])

    @property
    def squared_mean(self) -> NDArray:
        """Unbiased square of the expected luminance of each pixel of the mask [P].

        By products of different batches, in which no sample is squared.
        """
        means = np.array([p.mean[self.mask] for p in self.passes])
        n = len(means)
        return (np.square(means.sum(0)) - np.square(means).sum(0)) / (n * (n - 1))

    @property
    def variance_of_mean(self) -> NDArray:
        """Of :attr:`mean` [H, W], from the moments of all samples."""
        return np.mean([p.variance for p in self.passes], 0) / self.spp

    @property
    def scatter_of_mean(self) -> NDArray:
        """Variance of :attr:`mean` [H, W] again, from the spread of the batches.

        Never negative, and right where a sampler is so good that the moments, which Mitsuba
        adds up in single precision, cancel.
        """
        return variance_from_batches([p.mean for p in self.passes], 1.0) / len(self.passes)


def render_batches(
    prepared: Prepared,
    job: Job,
    *,
    batches: int,
    spp: int,
    max_seconds: float,
    seed: int,
    notify: Callable[[str], None],
    label: str = "",
    more: Callable[[Batches], bool] = lambda done: False,
    most: int = 0,
    more_seconds: float = 0.0,
) -> Batches:
    """``batches`` renders of ``spp`` samples per pixel, of seeds ``seed``, ``seed + 1``, ...

    A slow method takes fewer samples a batch, so that all end in about ``max_seconds``; if
    they do not, batches after the sixth are left out. Then others follow as long as ``more`` says
    so, up to ``most`` in all and for about ``more_seconds``.

    Raises:
        FloatingPointError: a pixel is not finite.
    """
    name = f"{job.method.name}, {label}" if label else job.method.name
    notify(f"{name}: warm-up")
    checked(prepared.render(LEAST_SPP, job.seed + 98), job)
    once = checked(prepared.render(LEAST_SPP, job.seed + 99), job)
    affordable = max_seconds / batches / (once.seconds / LEAST_SPP)
    spp = int(min(spp, max(LEAST_SPP, affordable)))
    passes, spent = [], 0.0
    for batch in range(batches):
        notify(f"{name}: batch {batch + 1} of {batches} at {spp} spp")
        passes.append(checked(prepared.render(spp, seed + batch), job))
        spent += passes[-1].seconds
        if spent > max_seconds and batch + 1 >= LEAST:
            break
    spent, looked = 0.0, len(passes)
    while len(passes) < most and spent < more_seconds:
        # A look costs as much as a batch of few samples: not after every one.
        if len(passes) >= looked:
            if not more(Batches(passes, prepared.mask)):
                break
            looked = len(passes) + max(1, len(passes) // 4)
        notify(f"{name}: batch {len(passes) + 1}, for the test of its mean")
        passes.append(checked(prepared.render(spp, seed + len(passes)), job))
        spent += passes[-1].seconds
    return Batches(passes, prepared.mask)
