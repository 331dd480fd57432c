"""A material learned from walks: one that is shipped, or a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials.kinds.base import Kind, only, path_of, where_of
from harness.materials.puresample import files


class PureSample(Kind):
    """``{name, type: puresample, file}``; without a file, the shipped one of that name."""

    type = "puresample"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("file",))
        files.check(self._file(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return files.identity(self._file(spec, base), where_of(spec))

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return files.make(spec["name"], self._file(spec, base), what)

    @staticmethod
    def _file(spec: Mapping[str, Any], base: Path) -> Path:
        """The file that a specification means."""
        if "file" in spec:
            return path_of(spec, base)
        known = files.shipped()
        if spec["name"] not in known:
            raise InputError(
                f"unknown material learned from walks '{spec['name']}'"
                f"{nearest(spec['name'], known)}; 'harness material train {spec['name']}"
                " --kind puresample' makes one of a description"
            )
        return known[spec["name"]]


KIND = PureSample()
