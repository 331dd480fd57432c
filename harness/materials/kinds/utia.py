"""A measured anisotropic BRDF of the UTIA database."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.materials.kinds.base import Kind, hash_of_file, is_number, only, path_of, where_of


class Utia(Kind):
    """``{name, type: utia, file, scale}``: the BRDF is the file's values times ``scale``."""

    type = "utia"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        from harness.materials import utia

        only(spec, ("file", "scale"))
        scale = spec.get("scale", 1)
        if not (is_number(scale) and scale > 0):
            raise InputError(f"{where_of(spec)}: scale: expected a number above 0, got {scale!r}")
        utia.check(path_of(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        scale = float(spec.get("scale", 1))
        return {"type": "utia", "sha256": hash_of_file(spec, base), "scale": scale}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        from harness.materials.utia import UtiaMaterial

        return UtiaMaterial(spec["name"], path_of(spec, base), what["scale"], what)


KIND = Utia()
