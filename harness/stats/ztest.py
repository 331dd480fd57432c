r"""Do the mean images of several methods agree?

All unbiased methods share one expectation. Each method's mean image is held against the
average of the others'. Single pixels are useless for that: with heavy tails a pixel's mean
is not normal and its variance is mostly missed. So pixels are averaged over blocks; a
block's difference over its standard error is a Student t whose degrees of freedom are read
off the scatter of the variance estimates (Welch and Satterthwaite), and is turned into the
normal score of the same probability. Two statistics result: the chi-square of all block
scores (sees local disagreement), and the score of the whole image as one block (sees a
small bias everywhere).

Measured on synthetic images of 32 samples a pixel in blocks of 16: at the 5 % level 2-6 % of
true agreements are rejected for normal to log-normal (sigma 1.5) samples, 8 % at sigma 2,
where 32 samples are too few for any such test. Correct with a small level (0.001) in mind.

The others are averaged plainly, not by inverse variance: a pixel whose rare bright sample
was missed has too low a mean *and* too low a variance, so such weights would bias it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from harness.stats.blocks import SIZE, Blocks
from harness.stats.distributions import chi2_sf, normal_isf, normal_sf, t_sf


@dataclass(frozen=True)
class Agreement:
    """One method against the average of the others.

    ``scores`` are the normal scores per block [By, Bx] (nan where the mask leaves nothing),
    ``p_value`` is that of both statistics together (Sidak), to be corrected for the number
    of comparisons by :func:`holm`. ``difference`` is that of the image averages relative to
    the others', ``difference_error`` its standard error.
    """

    scores: NDArray
    chi_square: float
    dof: int
    chi_square_p: float
    global_score: float
    global_p: float
    p_value: float
    difference: float
    difference_error: float


def agreement(
    means: ArrayLike,
    variances: ArrayLike,
    mask: ArrayLike | None = None,
    block: int = SIZE,
) -> list[Agreement]:
    """Compare each of M mean images [M, H, W] with the average of the other M - 1.

    ``variances`` [M, H, W] are those of the means (variance of one sample / samples per
    pixel), independent between pixels and methods. ``mask`` [H, W] chooses pixels. Blocks
    with less than a quarter of their pixels chosen join no chi-square, only the whole image.

    Raises:
        ValueError: fewer than two images, shapes that differ, or a number that is not finite.
    """
    means = np.asarray(means, float)
    variances = np.asarray(variances, float)
    if means.ndim != 3 or len(means) < 2 or means.shape != variances.shape:
        raise ValueError(
            "expected means and variances [M, H, W] with M >= 2,"
            f" got {means.shape} and {variances.shape}"
        )
    chosen = np.ones(means.shape[1:], bool) if mask is None else np.asarray(mask, bool)
    blocks = [Blocks.of(m, v, chosen, block) for m, v in zip(means, variances, strict=True)]
    return agreement_of_blocks(blocks, block)


def agreement_of_blocks(images: Sequence[Blocks], block: int = SIZE) -> list[Agreement]:
    """:func:`agreement` of M images of which the moments of blocks were kept.

    All have the same chosen pixels; ``block`` is the side of a block in pixels.

    Raises:
        ValueError: fewer than two images, or other pixels chosen in one than in another.
    """
    pixels = images[0].pixels
    if len(images) < 2 or any(not np.array_equal(one.pixels, pixels) for one in images):
        raise ValueError("expected two images or more, with the same pixels chosen")
    local = _Sums(images)
    whole = _Sums([one.whole() for one in images])
    large = local.pixels * 4 >= block * block
    if not large.any():
        large = local.pixels > 0
    return [_compare(local, whole, m, large, pixels.shape) for m in range(len(images))]


def holm(p: ArrayLike) -> NDArray:
    """Adjusted p-values [n] for n tests, dependent or not (Holm, 1979).

    Rejecting where the adjusted value is below alpha wrongly rejects any with at most alpha.
    """
    p = np.asarray(p, float)
    order = np.argsort(p)
    steps = p[order] * np.arange(len(p), 0, -1)
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return adjusted


class _Sums:
    """Per method and block: mean, its variance, and the variance of that estimate."""

    def __init__(self, images: Sequence[Blocks]):
        n = self.pixels = images[0].pixels.ravel()

        def each(part: str) -> NDArray:
            return np.stack([getattr(one, part).ravel() for one in images])

        with np.errstate(invalid="ignore", divide="ignore"):
            self.mean = each("mean")
            self.variance = each("variance") / n
            # Scatter of the pixels' variance estimates. True differences between pixels count
            # in too, which makes the test milder, never wilder.
            self.variance_of_variance = each("spread") ** 2 / (n - 1) / n**2


def _compare(local: _Sums, whole: _Sums, m: int, large: NDArray, shape: tuple) -> Agreement:
    scores = _scores(local, m)
    counted = scores[large]
    statistic = float((counted**2).sum())
    chi_p = float(chi2_sf(statistic, len(counted)))
    score = float(_scores(whole, m)[0])
    global_p = float(2 * normal_sf(abs(score)))
    others = np.arange(len(whole.mean)) != m
    reference = float(whole.mean[others, 0].mean())
    error = float(np.sqrt(_variance_of_difference(whole.variance, m)[0]))
    scale = abs(reference) if reference else float("nan")
    both = min(chi_p, global_p)
    return Agreement(
        scores=np.where(large, scores, np.nan).reshape(shape),
        chi_square=statistic,
        dof=len(counted),
        chi_square_p=chi_p,
        global_score=score,
        global_p=global_p,
        p_value=1 - (1 - both) ** 2,
        difference=(float(whole.mean[m, 0]) - reference) / scale,
        difference_error=error / scale,
    )


def _scores(sums: _Sums, m: int) -> NDArray:
    others = np.arange(len(sums.mean)) != m
    difference = sums.mean[m] - sums.mean[others].mean(0)
    variance = _variance_of_difference(sums.variance, m)
    weight = np.where(others, 1 / others.sum() ** 2, 1.0)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = (weight**2 * sums.variance_of_variance).sum(0)
        t = difference / np.sqrt(variance)
        dof = 2 * variance**2 / scatter
    # No noise at all: equal images agree perfectly, different ones not at all.
    t = np.where((variance == 0) & (difference == 0), 0.0, t)
    dof = np.where(scatter > 0, dof, np.inf)
    return np.sign(t) * normal_isf(t_sf(np.abs(t), dof))


def _variance_of_difference(variance: NDArray, m: int) -> NDArray:
    others = np.arange(len(variance)) != m
    return variance[m] + variance[others].sum(0) / others.sum() ** 2
