"""The random walk of a model that is known by its walks alone."""

from __future__ import annotations

from typing import Any

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.material import Material
from harness.core.protocol.method import refuse_unsupported


class RandomWalk(ColumnMethod):
    r"""A walk from ``wi`` until it leaves: Heitz et al. (2016), Guo et al. (2018).

    Needs ``material.walk_columns(c, u)``. Its directions are in proportion to f but for
    absorption, and the estimate is the walk's throughput, whose mean over the directions in a
    region is the integral of f there: unbiased, without any evaluation of f.

    The density of the direction has no closed form. :meth:`pdf` is that of the material's
    native sampler, which resembles it; multiple importance sampling may use it, for it is
    unbiased with any density that both strategies are weighed by. ``exact_pdf`` says that
    nothing may be divided by it. Uses three uniforms; what the walk needs beyond them is
    hashed from their bits.
    """

    name = "random-walk"
    exact_pdf = False

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the material has walks."""
        if not callable(getattr(material, "walk_columns", None)):
            return False, f"material '{material.name}' is not known by random walks"
        return True, ""

    def bind(self, material: Material) -> None:
        """See :meth:`Method.bind`; refuses a material without walks."""
        refuse_unsupported(self, material)
        super().bind(material)

    def sample_weighted_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float, Any]:
        """See :meth:`ColumnMethod.sample_weighted_columns`."""
        x, y, weight = self.material.walk_columns(c, u)
        return x, y, self.material.native_pdf_columns(c, [x, y]), weight

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`; the density is the approximation."""
        return self.sample_weighted_columns(c, u)[:3]

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`; an approximation."""
        return self.material.native_pdf_columns(c, wo)
