r"""A random height field whose slopes follow Beckmann's distribution.

A Gaussian random field has Gaussian slopes, and Beckmann's distribution is that of normals
whose slopes are independent Gaussians of deviation :math:`\alpha / \sqrt 2` along x and along y.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def heights(alpha_x: float, alpha_y: float, size: int, correlation: float, seed: int) -> Array:
    r"""Heights [size, size], in widths of the tile, of a field that tiles.

    Its correlation is Gaussian, with a length of ``correlation`` texels along the steeper axis and
    longer along the other, which makes slopes of both roughnesses from one height. The
    slopes of its triangles (of the mesh of :mod:`harness.geometry.shapes`, which cuts squares along
    one diagonal) have the root mean squares :math:`\alpha / \sqrt 2` up to chance, which is that of
    (size / correlation)^2 independent places; their mean over both axes is exact.
    """
    random = np.random.default_rng(seed)
    noise = np.fft.rfft2(random.standard_normal((size, size)))
    u, v = np.fft.rfftfreq(size), np.fft.fftfreq(size)[:, None]
    length_x = correlation * max(1.0, alpha_y / alpha_x)
    length_y = correlation * max(1.0, alpha_x / alpha_y)
    # The root of the spectrum of exp(-(x / length_x)^2 - (y / length_y)^2).
    root = np.exp(-0.5 * np.pi**2 * ((u * length_x) ** 2 + (v * length_y) ** 2))
    field = np.fft.irfft2(noise * root, (size, size))
    du = (np.roll(field, -1, 1) - field) * size
    dv = (np.roll(field, -1, 0) - field) * size
    found = np.sqrt(((du / alpha_x) ** 2 + (dv / alpha_y) ** 2).mean())
    return field / found
