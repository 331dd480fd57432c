"""KL divergence and mean squared error of the density, for chosen conditions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from harness.core.record import Numbers, Raw, Record
from harness.stats.divergence import kl_divergence, mean_squared_error


def numbers(raw: Raw) -> Numbers:
    """See :class:`harness.measures.slices.Slices`."""
    kl, _ = divergences(raw.arrays)
    return Numbers([Record("kl-mean", float(kl.mean()), unit="nats")])


def divergences(arrays: Mapping[str, NDArray]) -> tuple[NDArray, NDArray]:
    """KL in nats and mean squared error of each condition, [K] and [K].

    Of ``target`` and ``pdf`` [K, n, n], cell centres of [-1, 1]^2, nan off the disk.
    """
    target, pdf = arrays["target"], arrays["pdf"]
    inside = _inside(target.shape[-1])
    p_star, p = target[:, inside].astype(float), pdf[:, inside].astype(float)
    cell = (2 / target.shape[-1]) ** 2
    return kl_divergence(p_star, p, cell), mean_squared_error(p_star, p, cell)


def _inside(n: int) -> NDArray[np.bool_]:
    """Which cell centres [n, n] lie on the disk."""
    axis = (np.arange(n) + 0.5) * (2 / n) - 1
    return np.add.outer(axis**2, axis**2) < 1
