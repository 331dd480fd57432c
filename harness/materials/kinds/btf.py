"""A measured BTF in the University of Bonn's files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.materials.file_formats import said_of
from harness.materials.kinds.base import Kind, hash_of_file, only, path_of, where_of
from harness.microgeometry import btf_file


class Btf(Kind):
    """``{name, type: btf, file}``."""

    type = "btf"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("file",))
        path = path_of(spec, base)
        try:
            btf_file.check(path, where_of(spec))
        except InputError as error:
            known = said_of(path)
            raise InputError(f"{error}; it is {known}" if known else str(error)) from None

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return {"type": "btf", "sha256": hash_of_file(spec, base)}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        from harness.materials.btf import BtfMaterial

        return BtfMaterial(spec["name"], path_of(spec, base), what)


KIND = Btf()
