"""A network of Sztrajman et al. (2021), as its authors publish it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.material import Material
from harness.materials.kinds.base import Kind, only, path_of, where_of
from harness.mitsuba_runtime.mitsuba_xml import file_hash


class Nbrdf(Kind):
    """``{name, type: nbrdf, file: NAME_fc1.npy}``, the other five beside it; or ``NAME.h5``."""

    type = "nbrdf"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        from harness.materials import nbrdf

        only(spec, ("file",))
        nbrdf.read(path_of(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        from harness.materials import nbrdf

        files = nbrdf.files(path_of(spec, base))
        return {"type": "nbrdf"} | {k: file_hash(f, where_of(spec)) for k, f in files.items()}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        from harness.materials import nbrdf

        arrays = nbrdf.read(path_of(spec, base), where_of(spec))
        return nbrdf.NbrdfMaterial(spec["name"], arrays, what)


KIND = Nbrdf()
