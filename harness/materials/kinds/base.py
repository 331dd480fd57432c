"""What a kind of material is, and what several of them share.

A file of this folder holds one kind and assigns it to ``KIND``; that is all it takes to be found.
Neither Mitsuba nor Dr.Jit is loaded before a material is made.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.mitsuba_runtime.mitsuba_xml import file_hash


class Kind(ABC):
    """One ``type``. Specifications have a name; relative files are meant from ``base``."""

    type: ClassVar[str]
    """What a specification calls it."""

    @abstractmethod
    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        """Raise :class:`InputError` if ``spec`` cannot be followed, as far as files tell."""

    @abstractmethod
    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        """What determines the reflectance, of a valid ``spec``."""

    @abstractmethod
    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        """The material of a valid ``spec``; ``what`` is its identity."""


def where_of(spec: Mapping[str, Any]) -> str:
    """What a message calls the specification."""
    return f"material '{spec['name']}'"


def only(spec: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    """Refuse other keys than ``name``, ``type`` and ``keys``."""
    for key in spec:
        if key not in ("name", "type", *keys):
            hint = nearest(str(key), ("name", "type", *keys))
            raise InputError(f"{where_of(spec)}: unknown key '{key}'{hint}")


def path_of(spec: Mapping[str, Any], base: Path) -> Path:
    """The file that ``spec`` names under ``file``."""
    value = spec.get("file")
    if not isinstance(value, str) or not value:
        raise InputError(f"{where_of(spec)}: file: expected the name of a file, got {value!r}")
    return base / value


def hash_of_file(spec: Mapping[str, Any], base: Path) -> str:
    """SHA-256 of that file."""
    return file_hash(path_of(spec, base), where_of(spec))


def by_mitsuba(spec: Mapping[str, Any], what: dict[str, Any], bsdf: Callable[[], Any]) -> Material:
    """The material of a Mitsuba dictionary or BSDF, which ``bsdf`` makes."""
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    return MitsubaMaterial(spec["name"], bsdf(), what, bsdf)


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite number, and not true or false."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)
