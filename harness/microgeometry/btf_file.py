"""Reads bidirectional texture functions in the University of Bonn's ``.btf`` files.

The layout was learnt from the University's own ``btflib`` (github.com/cgbonn/btflib), which is
its only published description; this is an implementation of its own. Little-endian:

===================  ==========================================================================
signature            ``!DFMF08FCR``, ``!FMF12FCER``, ``!FMF06FCR`` or ``!FMF06FC``
meta data            its size in bytes, version; three texts of 80 bytes (setup, sensor, light);
                     pixels per mm; 3 scale factors; from version 2 the cosine flag, 3 an XML
                     text, 4 the names of the channels
sampling             views; for each view its polar and azimuth angle, the number of lights and
                     theirs (the same for all views), in radians
size                 width, height
rotations            their number, 3x3 each (signatures that end in R)
factors              a matrix of directions x texels as ``U (S V)^T``, in half precision or more:
                     one for each decorrelated channel (DFMF) or one for all (FMF)
===================  ==========================================================================

Direction ``light + n_lights * view``, texel ``x + width * y``. Not read: vertex factorisations
(PVF), raw images (BDI), local frames (rotations), channels other than three.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from harness.core.protocol.errors import InputError

SIGNATURES = ("!DFMF08FCR", "!FMF12FCER", "!FMF06FCR", "!FMF06FC")
"""Those that can be read; where one begins another, the longer comes first."""

EPSILON = 1e-5
"""Added before values were made logarithms."""

YUV = np.array([[1, 0, 1.13983], [1, -0.39465, -0.5806], [1, 2.03211, 0]], np.float32)
YCOCG = np.array([[1, 1, -1], [1, 0, 1], [1, -1, -1]], np.float32)

Array = NDArray[np.float32]


class Factors(NamedTuple):
    """One channel: value = sum_k directions[light + n_lights view, k] * texels[x + width y, k]."""

    directions: Array
    texels: Array


@dataclass(frozen=True)
class Btf:
    """A measured BTF, still in factors."""

    lights: Array
    """Directions to the lights [L, 3], unit vectors."""
    views: Array
    """Directions to the cameras [V, 3]."""
    width: int
    height: int
    has_cosine: bool
    """Whether the values include the cosine of the light's polar angle."""
    channels: tuple[Factors, Factors, Factors]
    colour_model: int
    mean: Array
    """Of the colour, [3]; used by the model of principal components."""
    matrix: Array
    """Rows [3, 3] are the principal components."""

    def colours(self, values: Array) -> Array:
        """RGB [..., 3] of what the factors give, [..., 3]."""
        return COLOUR_MODELS[self.colour_model](self, values)


def _of_log_luma(btf: Btf, v: Array) -> Array:
    return np.concatenate([np.exp(v[..., :1]) - EPSILON, v[..., 1:]], -1) @ YUV.T


def _of_log_luma_ratios(btf: Btf, v: Array) -> Array:
    luma = np.exp(v[..., :1])
    return np.concatenate([luma - EPSILON, v[..., 1:] * luma], -1) @ YUV.T


COLOUR_MODELS: dict[int, Callable[[Btf, Array], Array]] = {
    0: lambda btf, v: v,
    1: lambda btf, v: v @ YUV.T,
    3: lambda btf, v: v @ btf.matrix + btf.mean,
    4: lambda btf, v: v @ YCOCG.T,
    9: _of_log_luma,
    11: _of_log_luma_ratios,
    12: lambda btf, v: np.exp(v) - np.float32(EPSILON),
}
"""RGB, YUV, principal components, YCoCg, log Y with U and V, log Y with U/Y and V/Y, log RGB."""


def check(path: Path, where: str) -> None:
    """Refuse, without reading it all, what is no file or begins like no BTF that can be read.

    ``where`` names what the file was given for.
    """
    try:
        with path.open("rb") as file:
            start = file.read(max(map(len, SIGNATURES)))
    except OSError as error:
        raise InputError(f"{where}: {path} cannot be read: {error.strerror}") from None
    try:
        _signature(start)
    except InputError as error:
        raise InputError(f"{where}: {path}: {error}") from None


def read(path: Path) -> Btf:
    """The BTF in ``path``; :class:`InputError` names the file and what was expected."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return _parse(_Reader(data))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


class _Reader:
    """A position in the bytes of a file."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    def bytes(self, count: int) -> bytes:
        if self.at + count > len(self.data):
            raise InputError(f"ends after {len(self.data)} bytes; expected more")
        self.at += count
        return self.data[self.at - count : self.at]

    def one(self, code: str) -> int:
        return struct.unpack(f"<{code}", self.bytes(struct.calcsize(code)))[0]

    def array(self, dtype: str, *shape: int) -> Array:
        count = math.prod(shape)
        raw = self.bytes(count * np.dtype(dtype).itemsize)
        return np.frombuffer(raw, f"<{dtype}").reshape(shape).astype(np.float32)


def _parse(reader: _Reader) -> Btf:
    signature = _signature(reader.data)
    reader.bytes(len(signature))
    has_cosine = _meta_data(reader)
    lights, views = _sampling(reader)
    width, height = reader.one("I"), reader.one("I")
    if not (width and height):
        raise InputError(f"has {width} x {height} texels; expected some")
    if signature.endswith("R") and reader.one("I"):
        raise InputError("has local frames (rotations); expected a BTF on one plane")
    shape = (len(lights) * len(views), width * height)
    model, mean, matrix = 0, np.zeros(3, np.float32), np.eye(3, dtype=np.float32)
    if signature.startswith("!DFMF"):
        reader.one("I")
        model = reader.one("i")
        mean, matrix = reader.array("f4", 3), reader.array("f4", 3, 3)
        channels = [_oriented(*_factors(reader, reader.one("B")), shape) for _ in range(3)]
    else:
        version = reader.one("B") if signature.startswith("!FMF12") else 0
        if version > 2:
            raise InputError(f"unknown version of the header: {version}; expected 0 to 2")
        model = 12 if version >= 1 and reader.one("I") else 0
        if version >= 2:
            reader.bytes(2 * reader.one("I") * reader.one("I"))  # heights of the surface
        reader.one("I")
        left, right = _factors(reader, reader.one("B"))
        channels = _split(left, right, shape)
    if model not in COLOUR_MODELS:
        known = ", ".join(map(str, COLOUR_MODELS))
        raise InputError(f"unknown colour model {model}; expected one of {known}")
    return Btf(lights, views, width, height, has_cosine, tuple(channels), model, mean, matrix)


def _signature(data: bytes) -> str:
    for signature in SIGNATURES:
        if data.startswith(signature.encode()):
            return signature
    start = data[:10].decode("ascii", "replace")
    raise InputError(f"expected a BTF that begins with {', '.join(SIGNATURES)}, got {start!r}")


def _meta_data(reader: _Reader) -> bool:
    """Whether values include the cosine of the light."""
    start, size, version = reader.at, reader.one("I"), reader.one("I")
    reader.bytes(3 * 80 + 4 + 12)
    has_cosine = bool(reader.one("I")) if version > 1 else False
    if version > 2:
        reader.bytes(reader.one("I"))
    count = 3
    if version > 3:
        count = reader.one("I")
        for _ in range(count):
            reader.bytes(reader.one("I"))
    if count != 3:
        raise InputError(f"has {count} colour channels; expected 3")
    if reader.at != start + size:
        raise InputError(f"meta data of {reader.at - start} bytes; expected {size}")
    return has_cosine


def _sampling(reader: _Reader) -> tuple[Array, Array]:
    """``(lights [L, 3], views [V, 3])``; all views must have the same lights."""
    views, lights = [], None
    for _ in range(reader.one("I")):
        views.append(reader.array("f4", 2))
        here = reader.array("f4", reader.one("I"), 2)
        if lights is not None and not np.array_equal(lights, here):
            raise InputError("lights differ between views; expected the same for all")
        lights = here
    if lights is None or len(lights) < 3 or len(views) < 3:
        raise InputError("expected at least 3 views and 3 lights")
    return _vectors(lights), _vectors(np.stack(views))


def _vectors(angles: Array) -> Array:
    polar, azimuth = angles[:, 0], angles[:, 1]
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], 1)


def _factors(reader: _Reader, scalar: int) -> tuple[Array, Array]:
    """``(U [rows, K], S V [columns, K])``."""
    if scalar not in (2, 4, 8):
        raise InputError(f"numbers of {scalar} bytes; expected 2, 4 or 8")
    components, rows, columns = reader.one("I"), reader.one("I"), reader.one("I")
    dtype = f"f{scalar}"
    reader.array(dtype, components)  # singular values, which are in V already
    return reader.array(dtype, rows, components), reader.array(dtype, columns, components)


def _oriented(left: Array, right: Array, shape: tuple[int, int]) -> Factors:
    """Which of the two factors has the directions; ``shape`` is (directions, texels)."""
    if (len(left), len(right)) == shape:
        return Factors(left, right)
    if (len(right), len(left)) == shape:
        return Factors(right, left)
    raise InputError(
        f"factors of {len(left)} and {len(right)} rows; expected {shape[0]} directions"
        f" and {shape[1]} texels"
    )


def _split(left: Array, right: Array, shape: tuple[int, int]) -> list[Factors]:
    """One matrix for all channels, whose index runs fastest along one of its sides."""
    directions, texels = shape
    if len(left) in (3 * directions, 3 * texels):
        return [_oriented(left[c::3], right, shape) for c in range(3)]
    raise InputError(
        f"a factor of {len(left)} rows; expected 3 channels of {directions} directions"
        f" or {texels} texels"
    )
