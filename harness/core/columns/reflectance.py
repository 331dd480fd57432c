"""f over columns, whatever a material is written in."""

from __future__ import annotations

import drjit as dr

from harness.core.columns.bridge import Columns, columns_of, tensor_of
from harness.core.protocol.material import Material


def reflectance_columns(material: Material, c: Columns, wo: Columns) -> Columns:
    """BSDF without cosine, three columns; through torch where a material has no columns."""
    if callable(getattr(material, "eval_columns", None)):
        f = material.eval_columns(c, wo)
        return [f[0], f[1], f[2]]
    n = max(dr.width(v) for v in (*c, *wo))
    wide = [v if dr.width(v) == n else dr.repeat(v, n) for v in (*c, *wo)]
    rows = tensor_of(*wide, rows=n)
    return columns_of(material.eval(rows[:, :-2], rows[:, -2:]))
