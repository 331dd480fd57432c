"""Cosine-weighted hemisphere sampling: the floor that every other method must beat."""

from __future__ import annotations

import math

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod


class Cosine(ColumnMethod):
    r"""Uniform on the projected disk, whatever the material.

    .. math:: p_\perp(\omega) = \frac{1}{\pi}, \qquad p_\sigma(\omega) = \frac{\cos\theta}{\pi}

    Uses two uniforms. Every sample is valid, but for rounding at the rim.
    """

    name = "cosine"
    in_one_kernel = True
    uniforms = 2

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        radius = dr.sqrt(u[0])
        sin, cos = dr.sincos(2 * math.pi * u[1])
        x, y = radius * cos, radius * sin
        # The largest radii may round onto the rim, where there is no direction.
        return x, y, self.pdf_columns(c, [x, y])

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        x, y = wo
        return dr.select(dr.fma(x, x, y * y) < 1, type(x)(1 / math.pi), 0)
