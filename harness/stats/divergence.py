r"""How far a sampler's density is from its target, by quadrature over the disk.

``p_star`` and ``p`` [..., n] are densities per disk area at n points. Together the points stand for
the disk: each for a part of it of ``area`` [..., n], by default for one n-th (of cells of equal
area). ``p_star`` integrates to one; ``p`` integrates to one less the share of invalid samples, and
is taken as it is. Where ``p = 0 < p_star`` the divergences are infinite, which is the truth: that
light is never sampled. :func:`lost_share` says how much of it there is.
A negative or nan density gives nan.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

DISK_AREA = np.pi


def kl_divergence(p_star: ArrayLike, p: ArrayLike, area: ArrayLike | None = None) -> NDArray:
    r""":math:`\int p^* \log(p^*/p)`, in nats, [..., n] -> [...]."""
    p_star, p, ok = _pair(p_star, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        # p* log p* is 0 at p* = 0 by continuity, whatever p is there.
        terms = np.where(p_star > 0, p_star * (np.log(p_star) - np.log(p)), 0.0)
    return np.where(ok, _integral(terms, area), np.nan)


def chi_square_divergence(
    p_star: ArrayLike, p: ArrayLike, area: ArrayLike | None = None
) -> NDArray:
    r""":math:`\int p^{*2}/p - 1`, [..., n] -> [...].

    This is the relative variance of one sample under constant light, invalid samples
    (of estimate zero) counted in.
    """
    p_star, p, ok = _pair(p_star, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Nothing to estimate where p* = 0: no contribution, whatever p is there.
        terms = np.where(p_star > 0, p_star * (p_star / p), 0.0)
    return np.where(ok, _integral(terms, area) - 1, np.nan)


def mean_squared_error(p_star: ArrayLike, p: ArrayLike, area: ArrayLike | None = None) -> NDArray:
    """Average over the disk of ``(p - p_star)^2``, [..., n] -> [...]."""
    p_star, p, ok = _pair(p_star, p)
    square = np.square(p - p_star)
    whole = _integral(np.ones_like(square), area)
    return np.where(ok, _integral(square, area) / whole, np.nan)


def lost_share(p_star: ArrayLike, p: ArrayLike, area: ArrayLike | None = None) -> NDArray:
    """Share of the mass of ``p_star`` where ``p = 0``: light that is never sampled."""
    p_star, p, ok = _pair(p_star, p)
    lost = _integral(np.where(p == 0, p_star, 0.0), area) / _integral(p_star, area)
    return np.where(ok, lost, np.nan)


def _integral(values: NDArray, area: ArrayLike | None) -> NDArray:
    """Over the disk, of ``values`` [..., n] at points that stand for ``area`` each."""
    if area is None:
        return values.mean(-1) * DISK_AREA
    return (values * np.asarray(area, float)).sum(-1)


def _pair(p_star: ArrayLike, p: ArrayLike) -> tuple[NDArray, NDArray, NDArray]:
    p_star, p = np.broadcast_arrays(np.asarray(p_star, float), np.asarray(p, float))
    return p_star, p, ((p_star >= 0) & (p >= 0)).all(-1)
