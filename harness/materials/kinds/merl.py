"""A measured isotropic BRDF of the MERL database."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.material import Material
from harness.materials.kinds.base import Kind, hash_of_file, only, path_of, where_of


class Merl(Kind):
    """``{name, type: merl, file}``."""

    type = "merl"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        from harness.materials import merl

        only(spec, ("file",))
        merl.check(path_of(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return {"type": "merl", "sha256": hash_of_file(spec, base)}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        from harness.materials.merl import MerlMaterial

        return MerlMaterial(spec["name"], path_of(spec, base), what)


KIND = Merl()
