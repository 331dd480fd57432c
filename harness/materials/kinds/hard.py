"""A material that is hard on purpose, by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials.hard import registry as hard
from harness.materials.kinds.base import Kind, only


class Hard(Kind):
    """``{name, type: hard}``."""

    type = "hard"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ())
        name = spec["name"]
        if name not in hard.MATERIALS:
            raise InputError(f"unknown hard material '{name}'{nearest(name, hard.MATERIALS)}")

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        name = spec["name"]
        return {"type": "hard", "name": name}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return hard.MATERIALS[spec["name"]].make(spec["name"], what)


KIND = Hard()
