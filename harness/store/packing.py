"""What is put into the database as bytes: JSON and arrays, compressed and named by their digest."""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

_LEVEL = 9
MOST = 2**27
"""Bytes of one array or plan: no measure gives a tenth of it, and six megabytes may stand for it
forty times over."""
MOST_TEXT = 2**23
"""Bytes of one trial's description, or of a text that trials share."""
_PLAIN, _STEPS = b"=", b"~"
"""Begin what is not compressed, and arrays by steps; a stream of zlib begins otherwise."""


def digest(data: bytes) -> str:
    """First 16 hex digits of the SHA-256 of ``data``."""
    return hashlib.sha256(data).hexdigest()[:16]


def json_bytes(data: Any) -> bytes:
    """Canonical JSON of plain data; what is not finite is written as text ("nan", "inf")."""
    return json.dumps(_plain(data), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def pack(data: bytes, dictionary: bytes = b"", most: int = MOST) -> bytes:
    """Compressed; ``dictionary`` is a sample of what is often in such data.

    Raises:
        ValueError: it is of more than ``most`` bytes.
    """
    if len(data) > most:
        raise ValueError(f"{len(data):,} bytes are too many to be stored; at most {most:,}")
    given = (zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_DEFAULT_STRATEGY)
    packer = zlib.compressobj(_LEVEL, *given, *([dictionary] if dictionary else []))
    return packer.compress(data) + packer.flush()


def plain(data: bytes) -> bytes:
    """As :func:`pack`, but not compressed: for a database that is compressed as a whole."""
    return _PLAIN + data


def plain_array(data: bytes) -> bytes:
    """:func:`plain` of :func:`array_bytes`, in the form that compresses better.

    Numbers of single precision that are sorted, or smooth, are short steps from each to the next.
    """
    head, line, body = data.partition(b"\n")
    if not head.startswith(b'["<f4"'):
        return plain(data)
    steps = head + line + _steps(body)
    return _STEPS + steps if len(pack(steps)) < len(pack(data)) else plain(data)


def unpack(data: bytes, dictionary: bytes = b"", most: int = MOST) -> bytes:
    """What :func:`pack` compressed with the same dictionary, or with none.

    Or what :func:`plain` or :func:`plain_array` made.

    Raises:
        ValueError: not compressed by it, cut off, or of more than ``most`` bytes.
    """
    if data[:1] == _PLAIN:
        if len(data) > most + 1:
            raise ValueError(f"is more than {most:,} bytes")
        return data[1:]
    if data[:1] == _STEPS:
        head, line, body = data[1:].partition(b"\n")
        if len(data) > most + 1 or len(body) % 4:
            raise ValueError("is no array of steps, or a large one")
        return head + line + _summed(body)
    unpacker = zlib.decompressobj(zlib.MAX_WBITS, dictionary)
    try:
        found = unpacker.decompress(data, most)
    except zlib.error as error:
        raise ValueError(f"cannot be decompressed: {error}") from None
    if unpacker.unconsumed_tail:
        raise ValueError(f"is more than {most:,} bytes, decompressed")
    if not unpacker.eof:
        raise ValueError("cannot be decompressed: it is cut off")
    return found


def array_bytes(array: np.ndarray) -> bytes:
    """An array as bytes that compress well; objects are refused.

    A line of JSON (type in NumPy's notation, shape), then the elements, little-endian and
    C-ordered: the lowest byte of each, then the next, since the high ones resemble each other.
    """
    import numpy as np

    array = np.asarray(array, order="C")  # np.ascontiguousarray makes a scalar one-dimensional
    if array.dtype.hasobject or array.dtype.names:
        raise ValueError(f"an array of {array.dtype}: only numbers, truth values and text are kept")
    array = array.astype(array.dtype.newbyteorder("<"))
    head = json_bytes([array.dtype.str, array.shape]) + b"\n"
    return head + _planes(array.tobytes(), array.size, array.dtype.itemsize)


def array_of(data: bytes) -> np.ndarray:
    """The array of :func:`array_bytes`.

    Raises:
        ValueError: these are no bytes of it.
    """
    import numpy as np

    head, _, body = data.partition(b"\n")
    try:
        name, shape = json.loads(head)
        dtype = np.dtype(name)
        size = math.prod(shape)
        if dtype.hasobject or dtype.names or size * dtype.itemsize != len(body):
            raise ValueError("its bytes are not those of its type and shape")
        plain = _planes(body, dtype.itemsize, size)
        return np.ndarray(shape, dtype, bytearray(plain) if size else None)
    except (TypeError, SyntaxError, RecursionError, OverflowError) as error:
        raise ValueError(f"is no array: {error}") from None


def _steps(data: bytes) -> bytes:
    """Planes of 32-bit numbers as those of the differences of neighbours, small ones of few bits.

    In the order of their bits, floats of one sign are in that of their size.
    """
    import numpy as np

    bits = np.frombuffer(_planes(data, 4, len(data) // 4), "<u4")
    step = np.diff(bits, prepend=bits[:1] * 0).view("<i4")
    folded = (step << 1) ^ (step >> 31)  # the sign is the lowest bit
    return _planes(folded.astype("<i4").tobytes(), len(folded), 4)


def _summed(data: bytes) -> bytes:
    """The inverse of :func:`_steps`."""
    import numpy as np

    folded = np.frombuffer(_planes(data, 4, len(data) // 4), "<u4")
    bits = np.cumsum((folded >> 1) ^ np.negative(folded & 1), dtype="<u4")
    return _planes(bits.tobytes(), len(bits), 4)


def _planes(data: bytes, rows: int, columns: int) -> bytes:
    """The bytes of a table [rows, columns] as those of the one turned over."""
    import numpy as np

    return np.ndarray((rows, columns), np.uint8, data).T.tobytes() if data else b""


def parsed(text: bytes | str) -> Any:
    """The data of :func:`json_bytes`.

    Raises:
        ValueError: not JSON.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("lists and mappings too deep in each other") from None


def _plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return repr(data)
    return data
