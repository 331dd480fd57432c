"""A neural material: one that is shipped, or a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials.kinds.base import Kind, only, path_of, where_of
from harness.materials.neural import files as neural


class Neural(Kind):
    """``{name, type: neural, file}``; without a file, the shipped one of that name."""

    type = "neural"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("file",))
        neural.check(self._file(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return neural.identity(self._file(spec, base), where_of(spec))

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return neural.make(spec["name"], self._file(spec, base), what)

    @staticmethod
    def _file(spec: Mapping[str, Any], base: Path) -> Path:
        """The file that a specification means."""
        if "file" in spec:
            return path_of(spec, base)
        known = neural.shipped()
        if spec["name"] not in known:
            raise InputError(
                f"unknown neural material '{spec['name']}'{nearest(spec['name'], known)}"
            )
        return known[spec["name"]]


KIND = Neural()
