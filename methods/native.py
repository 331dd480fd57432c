"""The material's own sampler."""

from __future__ import annotations

import drjit as dr

from harness.core.columns.bridge import Columns, Float
from harness.core.columns.method import ColumnMethod
from harness.core.protocol.material import Material
from harness.core.protocol.method import refuse_unsupported


class Native(ColumnMethod):
    """The sampler that the material brings along, such as a Mitsuba BSDF's.

    Needs ``material.native_sample_columns(c, u)`` and ``material.native_pdf_columns(c, wo)``,
    both per disk area. Uses three uniforms: one to choose a lobe, two for the direction in
    it. Samples below the horizon are invalid and lie off the disk, with density zero.

    The density returned with a sample is taken at its point on the disk, rounded as it
    is handed out. The BSDF's own figure belongs to the three-dimensional direction, whose
    cosine the rounded point no longer tells exactly near the rim.
    """

    name = "native"
    in_one_kernel = True

    def supports(self, material: Material) -> tuple[bool, str]:
        """Whether the material has a sampler of its own."""
        for need in ("native_sample_columns", "native_pdf_columns"):
            if not callable(getattr(material, need, None)):
                return False, f"material '{material.name}' has no sampler of its own"
        return True, ""

    def bind(self, material: Material) -> None:
        """See :meth:`Method.bind`; refuses a material without a sampler."""
        refuse_unsupported(self, material)
        super().bind(material)

    def sample_columns(self, c: Columns, u: Columns) -> tuple[Float, Float, Float]:
        """See :meth:`ColumnMethod.sample_columns`."""
        x, y, _ = self.material.native_sample_columns(c, u)
        pdf = self.material.native_pdf_columns(c, [x, y])
        # Rounding may take a direction over an edge of the support, as a bent normal's horizon
        # is. Density and reflectance are zero there: no sample, and no light is lost.
        x, y = dr.select(pdf == 0, 2, x), dr.select(pdf == 0, 0, y)
        return x, y, pdf

    def pdf_columns(self, c: Columns, wo: Columns) -> Float:
        """See :meth:`ColumnMethod.pdf_columns`."""
        return self.material.native_pdf_columns(c, wo)
