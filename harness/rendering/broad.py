r"""A sampler that misses little, whatever the material: fitted to nothing, for references.

.. math:: q = \frac{1}{2\pi} + \frac{1}{2} \cdot \frac{1}{2\pi \ln(R/r)\,|\omega - m|^2}
          \quad (r < |\omega - m| < R)

Half uniform on the disk, half around the mirrored direction m with the distance spread evenly over
its logarithm, so that a lobe of any width has its share. Some samples are off the disk.
"""

from __future__ import annotations

import math

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod

NEAREST, FARTHEST = 2.0**-12, 2.0
"""Distances r and R from the mirrored direction."""
_LOG = math.log(FARTHEST / NEAREST)


class Broad(ColumnMethod):
    """See the module. Uses three uniforms."""

    name = "broad"
    in_one_kernel = True

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        sin, cos = dr.sincos(2 * math.pi * u[1])
        even, near = dr.sqrt(u[0]), NEAREST * dr.exp(_LOG * u[0])
        uniform = u[2] < 0.5
        x = dr.select(uniform, even * cos, near * cos - c[-2])
        y = dr.select(uniform, even * sin, near * sin - c[-1])
        return x, y, self.pdf_columns(c, [x, y])

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        x, y = wo
        squared = dr.square(x + c[-2]) + dr.square(y + c[-1])
        reached = (squared > NEAREST**2) & (squared < FARTHEST**2)
        near = dr.select(reached, 1 / (2 * math.pi * _LOG * squared), 0)
        even = dr.select(dr.fma(x, x, y * y) < 1, type(x)(1 / math.pi), 0)
        return (even + near) / 2
