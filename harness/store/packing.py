"""What is put into the database as bytes: JSON and arrays, compressed and named by their digest."""

from __future__ import annotations

import hashlib
import io
import json
import math
import zlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

_LEVEL = 9


def digest(data: bytes) -> str:
    """First 16 hex digits of the SHA-256 of ``data``."""
    return hashlib.sha256(data).hexdigest()[:16]


def json_bytes(data: Any) -> bytes:
    """Canonical JSON of plain data; what is not finite is written as text ("nan", "inf")."""
    return json.dumps(_plain(data), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def pack(data: bytes) -> bytes:
    """Compressed."""
    return zlib.compress(data, _LEVEL)


def unpack(data: bytes) -> bytes:
    """What :func:`pack` compressed.

    Raises:
        ValueError: not compressed by it.
    """
    try:
        return zlib.decompress(data)
    except zlib.error as error:
        raise ValueError(f"cannot be decompressed: {error}") from None


def array_bytes(array: np.ndarray) -> bytes:
    """An array in NumPy's own format, little-endian and C-ordered; objects are refused."""
    import numpy as np

    array = np.asarray(array, order="C")  # np.ascontiguousarray makes a scalar one-dimensional
    if array.dtype.hasobject:
        raise ValueError(f"an array of {array.dtype}: only numbers, truth values and text are kept")
    buffer = io.BytesIO()
    np.lib.format.write_array(
        buffer, array.astype(array.dtype.newbyteorder("<")), allow_pickle=False
    )
    return buffer.getvalue()


def array_of(data: bytes) -> np.ndarray:
    """The array of :func:`array_bytes`."""
    import numpy as np

    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def parsed(text: bytes | str) -> Any:
    """The data of :func:`json_bytes`.

    Raises:
        ValueError: not JSON.
    """
    return json.loads(text)


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return repr(data)
    return data
