"""The sizes of a neural material's network: its description, as stored beside the weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from harness.core.protocol.errors import InputError, nearest

ACTIVATIONS = ("leaky_relu", "relu")
OUTPUTS = ("linear", "log1p")


@dataclass(frozen=True)
class Architecture:
    """What determines the shapes of all tensors, and how they are read.

    ``resolution`` texels a side of the finest feature texture, of ``channels`` each;
    ``pyramid`` adds all coarser powers of two down to a single texel (eq. 3 of NeuMIP). With
    ``offset`` a second texture of ``offset_resolution`` and ``offset_channels`` and a network of
    its own move the lookup (eqs. 4-7). Both networks have ``layers`` hidden layers of ``width``.
    ``output`` is how the decoder's numbers y are read: as reflectance (``linear``) or as
    log(1 + reflectance) (``log1p``, NeuMIP's compression). With ``half_vector`` the decoder also
    sees the projection of the half vector of wi and wo, around which microfacet lobes lie; with
    ``cosines`` it sees those of wi and wo, and the offset's network that of wi: projected on the
    disk, all that happens at grazing angles lies within a hair of its rim. The papers' see neither.
    """

    resolution: int = 128
    channels: int = 8
    pyramid: bool = False
    offset: bool = True
    offset_resolution: int = 128
    offset_channels: int = 8
    width: int = 32
    layers: int = 3
    activation: str = "leaky_relu"
    output: str = "linear"
    half_vector: bool = False
    cosines: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "int" and (isinstance(value, bool) or not isinstance(value, int)):
                raise InputError(f"{field.name}: expected a whole number, got {value!r}")
            if field.type == "int" and value < 1:
                raise InputError(f"{field.name}: expected at least 1, got {value}")
            if field.type == "bool" and not isinstance(value, bool):
                raise InputError(f"{field.name}: expected true or false, got {value!r}")
        for name, known in (("activation", ACTIVATIONS), ("output", OUTPUTS)):
            value = getattr(self, name)
            if value not in known:
                raise InputError(f"{name}: unknown '{value}'{nearest(str(value), known)}")
        if self.pyramid and self.resolution & (self.resolution - 1):
            raise InputError(f"resolution: a pyramid needs a power of two, got {self.resolution}")

    @property
    def levels(self) -> int:
        """Textures in the pyramid, 1 without one; level 0 is the finest."""
        return self.resolution.bit_length() if self.pyramid else 1

    @property
    def directions(self) -> int:
        """Inputs of the decoder that are not features."""
        return 4 + 2 * self.half_vector + 2 * self.cosines

    def as_dict(self) -> dict[str, Any]:
        """As JSON data; inverse of :meth:`of`."""
        return asdict(self)

    @classmethod
    def of(cls, data: Mapping[str, Any], where: str = "architecture") -> Architecture:
        """From a mapping; :class:`InputError` names the key that is wrong."""
        known = [field.name for field in fields(cls)]
        for key in data:
            if key not in known:
                raise InputError(f"{where}: unknown key '{key}'{nearest(str(key), known)}")
        try:
            return cls(**data)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None


NEUSAMPLE = Architecture(resolution=512, offset_resolution=512)
"""NeuSample's simplified form: one resolution, eight features, offset. Sizes of its release."""

NEUMIP = Architecture(
    resolution=512,
    channels=7,
    pyramid=True,
    offset_resolution=512,
    offset_channels=7,
    width=25,
    layers=3,
    activation="relu",
    output="log1p",
)
"""NeuMIP as published: a pyramid of seven channels, four layers of 25, log(x + 1) at the end."""
