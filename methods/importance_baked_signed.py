"""The published sampling network with weights that its Jacobian makes unbiased."""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness._methods.importance_baked_published import ImportanceBakedPublished
from harness.core.columns.bridge import Columns, Float
from harness.core.columns.reflectance import reflectance_columns
from harness.core.protocol.method import Method
from harness.nets.tangents import with_tangents


class ImportanceBakedSigned(ImportanceBakedPublished):
    r"""Unbiased estimates of *any* learned map, folded or not: f times the signed Jacobian.

    The networks, encodings and losses are those of ``importance-baked-published``. Estimates are
    not the network's guess but

    .. math:: E_\xi\big[f(T(\xi)) \det J_T(\xi)\big] = \int f(\omega)\,\deg(T, \omega)\,d\omega

    (the area formula with signs). The degree counts the preimages of a direction with the signs
    of their determinants. It can change only where the square's boundary is mapped to, so it is
    one on the whole disk if T takes every edge of the square into the side that belongs to it:
    outputs g therefore act by :math:`t = \xi e^g / (1 - \xi + \xi e^g)`, which keeps 0 and 1, and
    :math:`(x, y) = (2 t_0 - 1,\; (2 t_1 - 1) \sqrt{1 - x^2})`. Nothing has to be invertible:
    where the map folds, estimates of negative weight cancel what is counted more than once, which
    costs variance and no bias. (The density of the samples, the sum of 1 / \|det J\| over all
    preimages, has no closed form; ``exact_pdf`` stays false, and :meth:`pdf` the pdf network's.)

    The price in time are two more passes through the network, for the derivatives, and f.
    Uses two uniforms.
    """

    name = "importance-baked-signed"
    note = "unbiased, of signed weights"

    eval = Method.eval

    def map(self, encoded: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Directions [..., 2] and log(1 + weight) [..., 3] at uniforms ``u`` [..., 2]."""
        g, log_weight = super().map(encoded, u)
        # Cells' centres are off the edges, where the logit is infinite.
        t = torch.sigmoid(torch.logit(u) + g)
        x = 2 * t[..., 0] - 1
        squared = 4 * t[..., 0] * (1 - t[..., 0])
        # The root's derivative at zero is infinite; there it multiplies nothing.
        chord = torch.where(squared > 0, squared, 1).sqrt() * (squared > 0)
        return torch.stack([x, (2 * t[..., 1] - 1) * chord], -1), log_weight

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """See :meth:`ColumnMethod.sample_weighted_columns`."""
        encoded = self.module.encoder.columns(c)
        x, y, jacobian = self.jacobian_columns(encoded, u)
        f = reflectance_columns(self.material, c, [x, y])
        return x, y, self._pdf(c, encoded, x, y), [v * jacobian for v in f]

    def jacobian_columns(self, encoded: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """Direction, and the determinant of its derivative by the uniforms."""
        point, slopes = self.module.encoder.point_columns(list(u[:2]))
        still = [type(point[0])(0)] * len(encoded)
        out, (by_a, by_b) = with_tangents(
            self.module.sampling, encoded + point, [still + s for s in slopes]
        )
        t, own, gain = [], [], []
        for v, g in zip(u[:2], out[:2], strict=True):
            e = dr.exp(g)
            below = 1 / dr.fma(v, e - 1, 1)
            t.append(v * e * below)
            own.append(e * below * below)  # by the uniform itself
            gain.append(v * (1 - v) * e * below * below)  # by the network's output
        det = (own[0] + gain[0] * by_a[0]) * (own[1] + gain[1] * by_b[1]) - (
            gain[0] * by_b[0] * gain[1] * by_a[1]
        )
        x = dr.fma(2, t[0], -1)
        # Of x near the ends this loses nothing: 1 - x^2 = 4 t (1 - t).
        chord = 2 * dr.sqrt(t[0] * (1 - t[0]))
        return x, dr.fma(2, t[1], -1) * chord, 4 * det * chord
