"""A measured BSDF in the tensor files of the RGL database."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.material import Material
from harness.materials import measured
from harness.materials.kinds.base import Kind, by_mitsuba, hash_of_file, only, path_of, where_of


class Measured(Kind):
    """``{name, type: measured, file}``."""

    type = "measured"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("file",))
        measured.check(path_of(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return {"type": "measured", "sha256": hash_of_file(spec, base)}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return by_mitsuba(spec, what, lambda: self._bsdf(spec, base))

    @staticmethod
    def _bsdf(spec: Mapping[str, Any], base: Path) -> Any:
        from harness.materials.mitsuba_bsdf import mitsuba

        mitsuba()  # sets the variant
        return measured.bsdf(path_of(spec, base), where_of(spec))


KIND = Measured()
