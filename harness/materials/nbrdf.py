r"""Networks of Sztrajman et al. 2021, Neural BRDF Representation, as the authors publish them.

Six arrays in numpy's format, ``NAME_fc1.npy`` [6, 21], ``NAME_fc2.npy`` [21, 21], ``NAME_fc3.npy``
[21, 3] and ``NAME_b1.npy``, ``NAME_b2.npy``, ``NAME_b3.npy``, of a network from half and difference
vector (with the half vector at azimuth zero) to the BRDF:

.. math:: f = \max(0, e^{W_3\,a(W_2\,a(W_1 [h, d] + b_1) + b_2) + b_3} - 1), \qquad a = \max(0, .)

Nothing in the files is executed: what is pickled is refused. The same network may be in a ``.h5``
file of Keras (:mod:`harness.materials.nbrdf_h5`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from harness.core.columns.bridge import Columns
from harness.core.protocol.errors import InputError
from harness.materials import nbrdf_h5
from harness.materials.file_formats import said_of
from harness.materials.half_difference import direction, half_and_difference
from harness.materials.measured_columns import MeasuredColumns

SHAPES = {"fc1": (6, 21), "b1": (21,), "fc2": (21, 21), "b2": (21,), "fc3": (21, 3), "b3": (3,)}


def files(path: Path) -> dict[str, Path]:
    """The six files, by array, of which ``path`` is one; or the one that holds all."""
    if path.suffix in nbrdf_h5.SUFFIXES:
        return {"h5": path}
    for part in SHAPES:
        if path.name.endswith(f"{part}.npy"):
            start = path.name.removesuffix(f"{part}.npy")
            return {key: path.with_name(f"{start}{key}.npy") for key in SHAPES}
    return {}


def read(path: Path, where: str) -> dict[str, NDArray[np.float32]]:
    """The six arrays.

    Raises:
        InputError: one is missing, is no plain array, or of another shape.
    """
    found = files(path)
    if not found:
        known = said_of(path) if path.is_file() else ""
        is_one = f"it is {known}" if known else "its name ends otherwise"
        raise InputError(
            f"{where}: {path}: expected one of six files NAME_fc1.npy, NAME_b1.npy, ..., or"
            f" NAME.h5: {is_one}"
        )
    if "h5" in found:
        return nbrdf_h5.read(path, SHAPES, where)
    arrays = {}
    for key, file in found.items():
        try:
            with file.open("rb") as stream:
                shape, dtype = _head(stream)
                if shape != SHAPES[key] or dtype.kind != "f":
                    raise InputError(
                        f"{where}: {file}: expected numbers of shape {list(SHAPES[key])}, got"
                        f" {dtype} of {list(shape)}"
                    )
                stream.seek(0)
                array = np.lib.format.read_array(stream, allow_pickle=False)
        except OSError as error:
            raise InputError(f"{where}: {file} cannot be read: {error.strerror}") from None
        except InputError:
            raise
        except Exception as error:  # numpy reads the head as Python, which has many ways to fail
            raise InputError(f"{where}: {file} is no array of numbers: {error}") from None
        arrays[key] = array.astype(np.float32)
    return arrays


def _head(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, before room is made for it."""
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    return shape, dtype


class NbrdfMaterial(MeasuredColumns):
    """One network; the condition is ``wi.xy``."""

    def __init__(self, name: str, arrays: dict[str, NDArray[np.float32]], identity: dict[str, Any]):
        super().__init__(name, identity)
        self._layers = [(arrays[f"fc{i}"], arrays[f"b{i}"]) for i in (1, 2, 3)]

    def eval_columns(self, c: Columns, wo: Columns) -> Any:
        """See :meth:`ColumnMaterial.eval_columns`."""
        (view, above), (light, inside) = direction(*c), direction(*wo)
        h, d = half_and_difference(light, view)
        # The network knows half vectors of azimuth zero alone: h.y is 0.
        values = [dr.sqrt(h[0] * h[0] + h[1] * h[1]), type(h[2])(0.0), h[2], *d]
        for i, (weight, bias) in enumerate(self._layers):
            values = [
                _weighted(values, weight[:, k], float(bias[k])) for k in range(weight.shape[1])
            ]
            if i < 2:
                values = [dr.maximum(v, 0) for v in values]
        rgb = [dr.maximum(dr.exp(v) - 1, 0) for v in values]
        return [dr.select(above & inside, v, 0) for v in rgb]


def _weighted(values: list[Any], weights: NDArray, bias: float) -> Any:
    total = type(values[0])(bias)
    for value, weight in zip(values, weights, strict=True):
        total = dr.fma(value, float(weight), total)
    return total
