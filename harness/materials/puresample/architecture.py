"""Sizes of a material learned from walks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.nets.activations import ACTIVATIONS
from harness.nets.domains import DOMAINS
from harness.nets.mixture_base import BASES

MOST = 4096
"""Of any size: a file that asks for more is damaged."""


@dataclass(frozen=True)
class Architecture:
    """Density: ``layers`` hidden layers of ``width``, ``steps`` of Euler's method, from ``base`` in
    ``domain`` (:mod:`harness.nets.domains`), ``frequencies`` of wi. Albedo: ``albedo_layers``
    hidden layers of ``albedo_width``, ``residual`` or plain. ``resolution`` and ``channels`` of the
    latent texture, 0 and 0 where the material is the same everywhere; ``albedo_channels`` more, of
    which the density knows nothing. ``grey``: one channel stands for all three.

    The paper's: width 64, albedo 2 x 32, domain ``disk``, 50 steps (10 after Reflow); with a
    texture of 256 texels and 32 channels width 128, albedo 5 x 128 with one residual layer. It has
    no channels of the albedo's own: a tint that changes no direction is then in no channel.
    """

    width: int = 64
    layers: int = 5
    activation: str = "silu"
    steps: int = 4
    domain: str = "plane"
    base: str = "lobes"
    frequencies: int = 3
    share: float = 0.01
    albedo_width: int = 32
    albedo_layers: int = 2
    residual: bool = False
    resolution: int = 0
    channels: int = 0
    albedo_channels: int = 0
    grey: bool = False

    @property
    def textured(self) -> bool:
        """Whether the material varies over its surface."""
        return self.channels > 0

    @property
    def features(self) -> int:
        """Numbers that the texture has at a place."""
        return self.channels + self.albedo_channels

    def as_dict(self) -> dict[str, Any]:
        """As JSON data."""
        return asdict(self)

    @classmethod
    def of(cls, data: Mapping[str, Any], where: str) -> Architecture:
        """From JSON data; :class:`InputError` names what is unknown, missing or out of range."""
        known = {field.name: type(field.default) for field in fields(cls)}
        for key, value in data.items():
            if key not in known:
                raise InputError(f"{where}: unknown size '{key}'{nearest(key, known)}")
            number = known[key] is float and type(value) is int
            if type(value) is not known[key] and not number:
                raise InputError(f"{where}: {key}: expected {known[key].__name__}, got {value!r}")
        found = cls(**data)
        for key, choices in (
            ("activation", ACTIVATIONS),
            ("domain", DOMAINS),
            ("base", BASES),
        ):
            if getattr(found, key) not in choices:
                value = getattr(found, key)
                raise InputError(f"{where}: {key}: unknown '{value}'{nearest(value, choices)}")
        for key in ("width", "layers", "steps", "albedo_width", "albedo_layers"):
            if not 1 <= getattr(found, key) <= MOST:
                value = getattr(found, key)
                raise InputError(f"{where}: {key}: expected 1 to {MOST}, got {value}")
        if not 0 <= found.frequencies <= 16 or not 0 <= found.share < 1:
            raise InputError(f"{where}: expected 0 to 16 frequencies and a share from 0 below 1")
        if (found.resolution > 0) != found.textured or not 0 <= found.resolution <= MOST:
            raise InputError(f"{where}: expected both of resolution and channels, or neither")
        for key in ("channels", "albedo_channels"):
            if not 0 <= getattr(found, key) <= 256:
                raise InputError(f"{where}: {key}: expected 0 to 256, got {getattr(found, key)}")
        if found.albedo_channels and not found.textured:
            raise InputError(f"{where}: albedo_channels: expected 0, there being no texture")
        return found
