"""Numbers over training seeds, and how far fits from different seeds lie apart.

A number is measured with every fit by a seed of its own (:mod:`harness.suite.seeds`), so that the
noise of two fits' numbers is independent: Student's t of the fits' values holds both the noise and
the spread between fits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from harness.analysis.combine import Z95, Estimate, over_seeds
from harness.stats.levels import spread_by_level

ONE_SEED = "one training seed: its spread is not known"


def training_seeds(planned: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """The seed of the fit that each planned trial is measured with, by the trial's key."""
    found = {}
    for row in planned:
        identity = row["identity"]
        found[row["trial"]] = identity.get("training_seed", identity.get("seed", row["seed"]))
    return found


def over_training_seeds(by_training: Mapping[int, list[Estimate]]) -> Estimate:
    """Mean over fits, each the mean over its own measuring seeds.

    Of one fit it is the mean over the measuring seeds, and says nothing of other fits.
    """
    fits = [over_seeds(estimates) for estimates in by_training.values()]
    return over_seeds(fits)


def training_spread(materials: Iterable[Mapping[int, list[Estimate]]]) -> Estimate | str:
    """Spread between fits beyond the noise of measuring, as a factor of one standard deviation.

    ``materials`` hold the numbers by training seed; their spread is pooled. The noise is what the
    intervals of the fits' own numbers tell (:func:`harness.stats.levels.spread_by_level`). A
    string says why there is none.
    """
    logs, errors = [], []
    for by_training in materials:
        fits = [over_seeds(estimates) for estimates in by_training.values()]
        if len(fits) < 2:
            continue
        if not all(0 < fit.value < math.inf for fit in fits):
            return "a number that is not positive and finite has no factor"
        if not all(fit.has_interval and fit.low > 0 for fit in fits):
            return "a number has no interval: noise cannot be told from spread"
        logs.append([math.log(fit.value) for fit in fits])
        errors.append([math.log(fit.high / fit.low) / (2 * Z95) for fit in fits])
    if not logs:
        return ONE_SEED
    return Estimate(*map(math.exp, spread_by_level(logs, errors).training))
