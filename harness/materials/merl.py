r"""Measured isotropic BRDFs of the MERL database (Matusik et al. 2003), ``.binary``.

The file: three int32 (90, 90, 180), then for red, green and blue 90 x 90 x 180 doubles, all
little-endian: cells of :math:`\theta_h` (finer towards zero: its square root is even), of
:math:`\theta_d` and of :math:`\phi_d` in [0, pi), the last the fastest. A value times the scale
of its channel (1/1500, 1.15/1500, 1.66/1500) is the BRDF per steradian. As in the database's own
code a lookup takes the cell that it falls into. Values below zero mark cells without data; they
stay as they are.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError
from harness.materials.file_formats import said_of
from harness.materials.half_difference import direction, half_and_difference
from harness.materials.measured_columns import MeasuredTable

SHAPE = (90, 90, 180)
"""Cells of theta_h, theta_d and phi_d."""
SCALES = (1 / 1500, 1.15 / 1500, 1.66 / 1500)
"""Of red, green and blue."""
BYTES = 12 + 3 * 8 * SHAPE[0] * SHAPE[1] * SHAPE[2]


def check(path: Path, where: str) -> None:
    """Refuse what is no file of the database, by its head and size."""
    try:
        with path.open("rb") as file:
            head = file.read(12)
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    if len(head) < 12 or struct.unpack("<3i", head) != SHAPE:
        known = said_of(path)
        is_one = f"it is {known}" if known else "it does not begin with 90, 90, 180"
        raise InputError(f"{where}: {path} is no table of the MERL database: {is_one}")
    if size != BYTES:
        raise InputError(
            f"{where}: {path} is a table of the MERL database that is cut short or longer: {size}"
            f" bytes, expected {BYTES}"
        )


def read(path: Path) -> NDArray[np.float32]:
    """The BRDF [3, 90, 90, 180] per steradian, scaled."""
    values = np.fromfile(path, "<f8", offset=12).reshape(3, *SHAPE)
    if not np.isfinite(values).all():
        raise InputError(f"{path} holds values that are not numbers")
    return (values * np.array(SCALES)[:, None, None, None]).astype(np.float32)


class MerlMaterial(MeasuredTable):
    """One table; the condition is ``wi.xy``."""

    def __init__(self, name: str, path: Path, identity: dict[str, Any]):
        super().__init__(name, read(path), identity)

    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """See :meth:`ColumnMaterial.eval_columns`."""
        (view, above), (light, inside) = direction(*c), direction(*wo)
        h, d = half_and_difference(light, view)
        theta_h = dr.atan2(dr.sqrt(h[0] * h[0] + h[1] * h[1]), h[2])
        theta_d = dr.atan2(dr.sqrt(d[0] * d[0] + d[1] * d[1]), d[2])
        # Both directions may change places, so half a turn of phi_d is all.
        phi_d = dr.atan2(d[1], d[0])
        phi_d = dr.select(phi_d < 0, phi_d + dr.pi, phi_d)
        cells = [
            _cell(dr.sqrt(theta_h * (2 / dr.pi)), SHAPE[0]),
            _cell(theta_d * (2 / dr.pi), SHAPE[1]),
            _cell(phi_d / dr.pi, SHAPE[2]),
        ]
        array = type(theta_h)
        table = self.table(array)
        index = 3 * ((cells[0] * SHAPE[1] + cells[1]) * SHAPE[2] + cells[2])
        valid = above & inside
        return [dr.select(valid, dr.gather(array, table, index + k), 0) for k in range(3)]


def _cell(unit: Any, count: int) -> Any:
    """Which of ``count`` equal cells of [0, 1] holds ``unit``; rounding leaves neither end."""
    cell = dr.int32_array_t(unit)(unit * count)
    return dr.uint32_array_t(unit)(dr.clip(cell, 0, count - 1))
