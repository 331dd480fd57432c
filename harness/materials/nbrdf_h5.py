"""The network of Sztrajman et al. in a file that Keras wrote (HDF5).

A layer is a group with one matrix [in, out] and one vector [out], wherever it lies and whatever
they are called (``kernel:0`` and ``bias:0``, or ``vars/0`` and ``vars/1``): the three shapes of the
matrices tell the layers apart. What else is in the file, such as a model's description as text, is
not read, and nothing is executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError

SUFFIXES = (".h5", ".hdf5")


def read(path: Path, shapes: Mapping[str, tuple[int, ...]], where: str) -> dict[str, NDArray]:
    """Arrays by name of ``shapes``: ``fc1`` and ``b1``, and so on.

    Raises:
        InputError: h5py is not installed, or a layer is missing, there twice, or no numbers.
    """
    try:
        import h5py
    except ImportError:
        raise InputError(
            f"{where}: {path}: to read .h5 files needs the package h5py, which is not installed"
            " (pip install h5py)"
        ) from None
    groups: dict[str, list[NDArray]] = {}

    def note(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or item.shape not in shapes.values():
            return
        # Numbers of this file alone; visititems follows no links to others.
        if item.dtype.kind == "f" and not (item.external or item.is_virtual):
            groups.setdefault(name.rpartition("/")[0], []).append(np.asarray(item, np.float32))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(note)
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{where}: {path}: no HDF5 file that can be read: {error}") from None
    found: dict[str, NDArray] = {}
    for key in (key for key in shapes if len(shapes[key]) == 2):
        bias = key.replace("fc", "b")
        wanted = [shapes[bias], shapes[key]]
        fitting = [g for g in groups.values() if sorted(a.shape for a in g) == sorted(wanted)]
        if len(fitting) != 1:
            raise InputError(
                f"{where}: {path}: expected one layer with a matrix {list(shapes[key])} and a"
                f" vector {list(shapes[bias])}, found {len(fitting)}"
            )
        found[bias], found[key] = sorted(fitting[0], key=lambda array: array.ndim)
    return found
