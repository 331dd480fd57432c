r"""Measured anisotropic BRDFs of the UTIA database (Filip and Vavra 2014), ``.bin``.

The file: for red, green and blue 288 x 288 doubles, little-endian, without a head. Rows are the
light, columns the view; both run over :math:`\theta` = 0, 15, ..., 75 degrees and, faster, over
:math:`\phi` = 0, 7.5, ..., 352.5 degrees. Between them values are interpolated linearly in all
four angles, and beyond 75 degrees continued on the line through the last two, as in the
database's own code. They are the BRDF times ``scale``; what they are measured in differs from
release to release of the database, so it is a key of the suite (1 by default).
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError
from harness.materials.file_formats import said_of
from harness.materials.half_difference import direction
from harness.materials.measured_columns import MeasuredTable

THETAS, PHIS = 6, 48
DIRECTIONS = THETAS * PHIS
BYTES = 3 * 8 * DIRECTIONS**2


def check(path: Path, where: str) -> None:
    """Refuse what is no file of the database, by its size: it has no head."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    if size != BYTES:
        known = said_of(path)
        is_one = f"it is {known}" if known else f"it has {size} bytes, expected {BYTES}"
        raise InputError(f"{where}: {path} is no table of the UTIA database: {is_one}")


class UtiaMaterial(MeasuredTable):
    """One table; the condition is ``wi.xy``, azimuths counted from the tangent dp_du."""

    def __init__(self, name: str, path: Path, scale: float, identity: dict[str, Any]):
        values = np.fromfile(path, "<f8").reshape(3, DIRECTIONS, DIRECTIONS)
        if not np.isfinite(values).all():
            raise InputError(f"material '{name}': {path} holds values that are not numbers")
        super().__init__(name, (scale * values).astype(np.float32), identity)

    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """See :meth:`ColumnMaterial.eval_columns`."""
        (view, above), (light, inside) = direction(*c), direction(*wo)
        array = type(light[2])
        table = self.table(array)
        total = [array(0.0) for _ in range(3)]
        corners = itertools.product(_neighbours(*light), _neighbours(*view))
        for (row, a), (column, b) in corners:
            index = 3 * (row * DIRECTIONS + column)
            for k in range(3):
                total[k] = dr.fma(a * b, dr.gather(array, table, index + k), total[k])
        return [dr.select(above & inside, value, 0) for value in total]


def _neighbours(x: Any, y: Any, z: Any) -> list[tuple[Any, Any]]:
    """``(number of a measured direction, its weight)`` of the four around a direction."""
    theta = dr.atan2(dr.sqrt(x * x + y * y), z) * (180 / dr.pi / 15)
    phi = dr.atan2(y, x) * (180 / dr.pi / 7.5)
    phi = dr.select(phi < 0, phi + PHIS, phi)
    whole = dr.int32_array_t(theta)
    i = dr.clip(whole(dr.floor(theta)), 0, THETAS - 2)
    j = dr.clip(whole(dr.floor(phi)), 0, PHIS - 1)
    s, t = theta - i, phi - j  # s passes one beyond the last theta: the line goes on
    after = dr.select(j == PHIS - 1, 0, j + 1)
    index = dr.uint32_array_t(theta)
    return [
        (index(row * PHIS + column), a * b)
        for row, a in ((i, 1 - s), (i + 1, s))
        for column, b in ((j, 1 - t), (after, t))
    ]
