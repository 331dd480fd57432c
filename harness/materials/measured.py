r"""Measured BSDFs in the tensor-file format of the RGL database (Dupuy and Jakob 2018).

Their data has hard cases that are left as they are: colour channels below zero (in some
files for a third of all pairs of directions), values in the hundreds and thousands, and a
sampler that loses up to a few percent of its samples below the horizon. The measure ``pdf``
records both, as ``negative-share`` and as the ``invalid-share`` of the method ``native``.

The file: the 12 bytes ``tensor_file\0``, a version of two bytes (1, 0), a count of fields
(uint32); then for each field the length of its name (uint16), the name, its dimension
(uint16), type (uint8), offset from the start of the file (uint64) and shape (uint64 each).
All numbers are little-endian.

Files with spectra instead of colours are read, too: each spectrum becomes a colour in linear Rec.
709 under the light D65, as Mitsuba turns any spectrum of a reflectance into one.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError
from harness.materials.file_formats import said_of

MAGIC = b"tensor_file\0"
NEEDED = ("phi_i", "theta_i", "ndf", "sigma", "vndf", "luminance", "jacobian")
"""Fields that Mitsuba's ``measured`` reads, beside ``rgb`` in a colour variant."""
SPECTRAL = ("spectra", "wavelengths")
"""Fields that a file has instead of ``rgb``: [..., n, H, W], and n nanometres."""

_TYPES = dict(
    enumerate("u1 i1 <u2 <i2 <u4 <i4 <u8 <i8 <f2 <f4 <f8".split(), start=1),
)
"""By the file's number of a type."""
_BYTES = {code: np.dtype(kind).itemsize for code, kind in _TYPES.items()}


class FieldHeader(NamedTuple):
    """One tensor of the file."""

    name: str
    type: int
    offset: int
    shape: tuple[int, ...]


def read_header(path: Path, where: str) -> list[FieldHeader]:
    """The fields of a tensor file, without their data.

    Raises:
        InputError: no such file, no tensor file, or cut short; ``where`` names what it was
            given for.
    """
    if not path.is_file():
        raise InputError(f"{where}: no such file: {path}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    if data[: len(MAGIC)] != MAGIC:
        known = said_of(path)
        is_one = f"it is {known}" if known else "it does not begin with 'tensor_file'"
        raise InputError(f"{where}: {path} is not a measured BSDF of the RGL database: {is_one}")
    try:
        fields = _fields(data)
    except (struct.error, UnicodeDecodeError, KeyError):
        raise InputError(f"{where}: {path} is damaged: its header cannot be read") from None
    for item in fields:
        count = 1
        for side in item.shape:
            count *= side
        if item.offset + count * _BYTES[item.type] > len(data):
            raise InputError(f"{where}: {path} is cut short: field '{item.name}' is not all there")
    return fields


def _fields(data: bytes) -> list[FieldHeader]:
    (count,) = struct.unpack_from("<I", data, 14)
    at, found = 18, []
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, at)
        name = data[at + 2 : at + 2 + length].decode()
        at += 2 + length
        dimension, kind, offset = struct.unpack_from("<HBQ", data, at)
        shape = struct.unpack_from(f"<{dimension}Q", data, at + 11)
        at += 11 + 8 * dimension
        _BYTES[kind]  # an unknown type is damage
        found.append(FieldHeader(name, kind, offset, shape))
    return found


def check(path: Path, where: str) -> None:
    """Refuse a file that is not a measured BSDF with colours or spectra."""
    names = {item.name for item in read_header(path, where)}
    needed = [*NEEDED, *(SPECTRAL if "spectra" in names else ("rgb",))]
    missing = [name for name in needed if name not in names]
    if missing:
        raise InputError(f"{where}: {path} is not a measured BSDF: it has no field '{missing[0]}'")


def bsdf(path: Path, where: str) -> Any:
    """What Mitsuba reads: the dictionary of a file with colours, the BSDF of one with spectra."""
    fields = read_header(path, where)
    if any(item.name == "rgb" for item in fields):
        return {"type": "measured", "filename": str(path.resolve())}
    import mitsuba as mi

    tensors = {item.name: tensor(path, item) for item in fields}
    with tempfile.TemporaryDirectory() as folder:
        coloured = Path(folder) / "rgb.bsdf"
        spectra, wavelengths = (tensors.pop(name) for name in SPECTRAL)
        coloured.write_bytes(written(tensors | {"rgb": colours(spectra, wavelengths)}))
        return mi.load_dict({"type": "measured", "filename": str(coloured)})


def tensor(path: Path, field: FieldHeader) -> NDArray:
    """The data of one field."""
    count = int(np.prod(field.shape))
    values = np.fromfile(path, _TYPES[field.type], count, offset=field.offset)
    return values.reshape(field.shape)


def written(tensors: Mapping[str, NDArray]) -> bytes:
    """A tensor file of these fields, in single precision where they are of floating point."""
    codes = {np.dtype(kind): code for code, kind in _TYPES.items()}
    head = MAGIC + bytes((1, 0)) + struct.pack("<I", len(tensors))
    at = len(head) + sum(len(n.encode()) + 13 + 8 * a.ndim for n, a in tensors.items())
    data = b""
    for name, array in tensors.items():
        array = array.astype("<f4") if array.dtype.kind == "f" else array
        head += struct.pack("<H", len(name.encode())) + name.encode()
        head += struct.pack("<HBQ", array.ndim, codes[array.dtype], at + len(data))
        head += struct.pack(f"<{array.ndim}Q", *array.shape)
        data += np.ascontiguousarray(array).tobytes()
    return head + data


def colours(spectra: NDArray, wavelengths: NDArray) -> NDArray[np.float32]:
    """Linear Rec. 709 [..., 3, H, W] under D65 of spectra [..., n, H, W] at n nanometres.

    Colours are linear in spectra, so those of n triangles between the wavelengths are all that
    is asked of Mitsuba; on top of white, for it cuts off what is below zero.
    """
    import mitsuba as mi

    grid = [float(w) for w in wavelengths]

    def colour(values: NDArray) -> NDArray:
        return np.array(mi.spectrum_list_to_srgb(grid, values.tolist(), False, True), np.float64)

    white = np.ones(len(grid))
    weights = np.array([colour(white + row) for row in np.eye(len(grid))]) - colour(white)
    return np.einsum("...nhw,nc->...chw", spectra.astype(np.float64), weights).astype(np.float32)
