r"""Measured BSDFs in the tensor-file format of the RGL database (Dupuy and Jakob 2018).

Their data has hard cases that are left as they are: colour channels below zero (in some
files for a third of all pairs of directions), values in the hundreds and thousands, and a
sampler that loses up to a few percent of its samples below the horizon. The measure ``pdf``
records both, as ``negative-share`` and as the ``invalid-share`` of the method ``native``.

The file: the 12 bytes ``tensor_file\0``, a version of two bytes (1, 0), a count of fields
(uint32); then for each field the length of its name (uint16), the name, its dimension
(uint16), type (uint8), offset from the start of the file (uint64) and shape (uint64 each).
All numbers are little-endian.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

from harness.core.protocol.errors import InputError

MAGIC = b"tensor_file\0"
NEEDED = ("phi_i", "theta_i", "ndf", "sigma", "vndf", "luminance", "rgb", "jacobian")
"""Fields that Mitsuba's ``measured`` reads in a colour variant."""

_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 8, 8: 8, 9: 2, 10: 4, 11: 8}
"""Bytes of one element, by the file's number of its type (u/int 8 to 64, float 16 to 64)."""


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
        raise InputError(
            f"{where}: {path} is not a measured BSDF: it does not begin with 'tensor_file'"
        )
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
    """Refuse a file that is not a measured BSDF with colours."""
    names = {item.name for item in read_header(path, where)}
    missing = [name for name in NEEDED if name not in names]
    if missing == ["rgb"] and "spectra" in names:
        raise InputError(f"{where}: {path} holds spectra; expected the file's '_rgb' version")
    if missing:
        raise InputError(f"{where}: {path} is not a measured BSDF: it has no field '{missing[0]}'")


def bsdf(path: Path) -> dict[str, Any]:
    """The Mitsuba dictionary."""
    return {"type": "measured", "filename": str(path.resolve())}
