"""All renders of a cell taken together: one variance, and speed-ups over the baseline from it.

The renders of equal samples and the timed ones estimate the same variance; pooled, each counts by
its samples per pixel. Where a trial of constant light stored the integral itself, that is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.analysis.process_pooling import PROCESSES, joined
from harness.analysis.second_moments import other_variance
from harness.stats.intervals import Interval
from harness.stats.log_estimate import log_ratio_of_medians
from harness.stats.log_interval import LogInterval
from harness.stats.paired import CORRELATED, Paired, paired_ratio
from harness.stats.variance import (
    RESOLVED,
    WIDEST,
    Deviations,
    Variance,
    confirmed,
    diagnosed,
)
from harness.store.stored import Stored

Arrays = Mapping[str, NDArray]


@dataclass(frozen=True)
class Pooled:
    """The variance of one sample of a cell, from ``spp`` samples of each pixel."""

    variance: Variance
    spp: float
    blocks: NDArray | None = None
    """Of the renders of equal samples, by block [B, G]; ``pixels`` [G] are theirs.

    Of an integral, of its two halves [2, G], whose points are the same for all methods.
    """
    pixels: NDArray | None = None
    batch_spp: int = 0
    exact: bool = False
    """Whether the variance is an integral."""
    doubt: str = ""
    """What else was found, where renders contradict the integral."""


@dataclass(frozen=True)
class Factor:
    """A speed-up: ``log`` with its interval where it is resolved, and what a reader has to know."""

    log: LogInterval
    resolved: bool
    note: str = ""
    heavy: bool = False
    """Whether one of the variances has a heavy tail: resolved, with a wider interval."""
    exact: bool = False
    """Whether both variances are integrals, not renders."""

    @property
    def interval(self) -> Interval:
        """Value and ends; the value is nan where it is not resolved."""
        value, low, high = self.log.interval
        return Interval(value if self.resolved else math.nan, low, high)

    @property
    def bound(self) -> str:
        """The one-sided bound in words, of a factor that is not resolved; "" without one."""
        _, low, high = self.log.interval
        if math.isfinite(high):
            return f"at most {high:.3g}"
        return f"at least {low:.3g}" if low > 0 else ""


def variance_of(same_spp: Stored | None, timed: Stored | None) -> Pooled | None:
    """Of a cell's two trials, either of which may be missing; None where no tail was stored."""
    parts: list[tuple[float, Deviations, float]] = []
    blocks: dict[str, Any] = {}
    other: Variance | None = None
    if same_spp is not None and "deviations" in (a := same_spp.arrays):
        spp = float(a["spp"])
        parts.append((_mean(a), Deviations.unpacked(a["deviations"]), spp))
        pixels = a["pixels"][a["pixels"] > 0].ravel()
        blocks = {
            "blocks": np.asarray(a["block_variance"], float),
            "pixels": pixels,
            "batch_spp": int(a["batch_spp"]),
        }
        other = other_variance(a)
    if timed is not None:
        a = joined(timed.arrays)
        # Of repeated processes, the deviations are each process's own.
        if "deviations" in a and PROCESSES not in a:
            spp = float(a["round_spp"]) * len(a["batch_variance"])
            parts.append((_mean(a), Deviations.unpacked(a["deviations"]), spp))
    if not parts:
        return None
    total = sum(spp for *_, spp in parts)
    weights = [spp / total for *_, spp in parts]
    mean = sum(w * value for w, (value, *_) in zip(weights, parts, strict=True))
    merged = Deviations.merged([d for _, d, _ in parts], weights)
    return Pooled(confirmed(diagnosed(mean, merged), other), total, **blocks)


def variance_ratio(base: Pooled, method: Pooled) -> Factor | None:
    """Of the baseline over the method; None where one of them has no variance.

    Where both used the same random numbers and are correlated, the pairs alone.
    """
    if base.variance.log is None or method.variance.log is None:
        return None
    pair = _paired(base, method)
    light = base.variance.tail == method.variance.tail == "light"
    if pair is not None and (pair.same or (light and pair.correlation > CORRELATED)):
        said = "; ".join(_doubts(base, method))
        return Factor(pair.ratio, True, said, exact=base.exact and method.exact)
    ratio = base.variance.log - method.variance.log
    notes = [_note("the baseline's", base.variance), _note("its", method.variance)]
    notes += _doubts(base, method)
    resolved = all(one.variance.tail != "not resolved" for one in (base, method))
    resolved &= ratio.factor <= WIDEST
    heavy = "heavy" in (base.variance.tail, method.variance.tail)
    exact = base.exact and method.exact
    return Factor(ratio, resolved, "; ".join(filter(None, notes)), heavy, exact)


def speed_up(ratio: Factor, base_seconds: NDArray, seconds: NDArray) -> Factor:
    """The ratio of variances times that of times, which are of the same rounds."""
    log = ratio.log + LogInterval.of(log_ratio_of_medians(base_seconds, seconds))
    return replace(ratio, log=log, resolved=ratio.resolved and log.factor <= WIDEST)


def _paired(base: Pooled, method: Pooled) -> Paired | None:
    if base.blocks is None or method.blocks is None or base.batch_spp != method.batch_spp:
        return None
    return paired_ratio(base.blocks, method.blocks, base.pixels)


def _note(whose: str, variance: Variance) -> str:
    if variance.tail in RESOLVED:
        return ""
    why = f" ({variance.why})" if variance.why else ""
    return f"{variance.tail}: {whose} variance{why}"


def _doubts(base: Pooled, method: Pooled) -> list[str]:
    """Of integrals that renders contradict."""
    named = (("the baseline's", base.doubt), ("its", method.doubt))
    return [f"renders contradict {whose} variance: {doubt}" for whose, doubt in named if doubt]


def _mean(arrays: Arrays) -> float:
    return float(np.asarray(arrays["batch_variance"], float).mean())
