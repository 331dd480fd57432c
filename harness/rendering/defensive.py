r"""The second moment of a method's estimates, by samples of which half are not the method's.

What a method samples too rarely, its own renders mostly miss, and their variance with it. A
mixture q of the method's density p and a broad one goes there. With L the light,

.. math:: E_p[(f L / p)^2] = \int \frac{f^2 L^2}{p} = E_q\left[\left(\frac{f L}{\sqrt{p q}}\right)^2
          \right],

so a render that is sampled by q, with weights :math:`f / \sqrt{p q}`, has in its second moments
those of the method. Its mean image means nothing. Where p = 0 the method never goes: that light is
lost, which is bias and no variance.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.columns.reflectance import reflectance_columns
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.method import DiskSample, Method, WeightedSample
from harness.effects.offer import recipe_of
from harness.rendering.broad import Broad

OWN = 0.5
"""Share of samples by the method."""


def applies(method: Method, scene: Any) -> bool:
    """Whether an estimate is f L / p: an exact pdf, one bounce, no light sampling."""
    recipe = recipe_of(scene)
    return method.exact_pdf and recipe.integrator == "direct" and not recipe.emitter_sampling


def second_moment(method: Method) -> Method:
    """What is to be rendered in place of ``method``."""
    columns = isinstance(method, ColumnMethod) and type(method).eval is Method.eval
    return (InColumns if columns else InRows)(method)


class InRows(Method):
    """Of a method in torch."""

    name = "second-moment"
    exact_pdf = False

    def __init__(self, method: Method):
        self.method, self.material, self.broad = method, method.material, Broad()

    def rebound(self, material: Any) -> Method:
        """See :meth:`Method.rebound`."""
        return type(self)(self.method.rebound(material))

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf, _ = self.sample_weighted(condition, u)
        return DiskSample(wo, pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Of the mixture."""
        p = self.method.pdf(condition, wo)
        return OWN * p + (1 - OWN) * self.broad.pdf(condition, wo)

    def sample_weighted(self, condition: Tensor, u: Tensor) -> WeightedSample:
        """Directions of q, weighted for a second moment."""
        mine = u[:, 2] < OWN
        # Each part of [0, 1) stretched to all of it.
        rest = torch.where(mine, u[:, 2] / OWN, (u[:, 2] - OWN) / (1 - OWN))
        again = torch.cat([u[:, :2], rest[:, None]], 1)
        own, other = (m.sample(condition, again).wo for m in (self.method, self.broad))
        wo = torch.where(mine[:, None], own, other)
        inside = inside_disk(wo)
        place = torch.where(inside[:, None], wo, 0)
        p = self.method.pdf(condition, place)
        q = OWN * p + (1 - OWN) * self.broad.pdf(condition, wo)
        weight = self.method.eval(condition, place) / (p * q).sqrt()[:, None]
        return WeightedSample(wo, q, torch.where((inside & (p > 0))[:, None], weight, 0))


class InColumns(ColumnMethod):
    """Of a method over columns."""

    name = "second-moment"
    exact_pdf = False

    def __init__(self, method: ColumnMethod):
        self.method, self.material, self.broad = method, method.material, Broad()

    def rebound(self, material: Any) -> Method:
        """See :meth:`Method.rebound`."""
        return type(self)(self.method.rebound(material))

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        return self.sample_weighted_columns(c, u)[:3]

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """Of the mixture."""
        p = self.method.pdf_columns(c, wo)
        return OWN * p + (1 - OWN) * self.broad.pdf_columns(c, wo)

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """Directions of q, weighted for a second moment."""
        mine = u[2] < OWN
        rest = dr.select(mine, u[2] / OWN, (u[2] - OWN) / (1 - OWN))
        own, other = (m.sample_columns(c, [*u[:2], rest]) for m in (self.method, self.broad))
        x, y = (dr.select(mine, a, b) for a, b in zip(own[:2], other[:2], strict=True))
        inside = dr.fma(x, x, y * y) < 1
        place = [dr.select(inside, x, 0), dr.select(inside, y, 0)]
        p = self.method.pdf_columns(c, place)
        q = OWN * p + (1 - OWN) * self.broad.pdf_columns(c, [x, y])
        valid = inside & (p > 0)
        scale = dr.select(valid, dr.rsqrt(dr.select(valid, p * q, 1)), 0)
        return x, y, q, [v * scale for v in reflectance_columns(self.material, c, place)]
