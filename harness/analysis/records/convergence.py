"""Error against samples per pixel and against seconds."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from harness.core.record import Numbers, Raw, Record
from harness.stats.distributions import t_quantile
from harness.stats.intervals import median_interval


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.convergence.Convergence`."""
    curve = curve_of(raw.arrays)
    spp, mse = curve["spp"], curve["mse"]
    last = (float(curve[name][-1]) for name in ("mse", "mse_low", "mse_high"))
    records = [Record("mse-last", *last, "radiance^2")]
    # A logarithm needs an error above the reference's noise; levels below it say nothing.
    usable = mse > 0
    if usable.sum() >= 3:
        (fit, _), covariance = np.polyfit(np.log(spp[usable]), np.log(mse[usable]), 1, cov=True)
        reach = t_quantile(0.975, int(usable.sum()) - 2) * math.sqrt(covariance[0, 0])
        slope = (float(fit + d) for d in (0.0, -reach, reach))
        records.append(Record("slope", *slope, "1"))
    return Numbers(records)


def curve_of(arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """``spp``, ``seconds`` and ``mse`` of each level [L], the last two with ``_low``, ``_high``.

    Of ``errors`` and ``all_seconds`` [L, repeats]. Seconds are medians, errors means with
    Student's t. Trials of before ``all_seconds`` was kept have the medians alone, in ``seconds``
    [L], and no interval of them.
    """
    errors = np.asarray(arrays["errors"], float)
    if "all_seconds" in arrays:
        times = np.array([median_interval(row) for row in arrays["all_seconds"]])
    else:
        times = np.full((len(errors), 3), math.nan)
        times[:, 0] = arrays["seconds"]
    mse, n = errors.mean(1), errors.shape[1]
    half = (
        t_quantile(0.975, n - 1) * errors.std(1, ddof=1) / math.sqrt(n)
        if n > 1
        else np.full_like(mse, math.nan)
    )
    return {
        "spp": np.asarray(arrays["spp"], float),
        "seconds": times[:, 0],
        "seconds_low": times[:, 1],
        "seconds_high": times[:, 2],
        "mse": mse,
        "mse_low": mse - half,
        "mse_high": mse + half,
    }
