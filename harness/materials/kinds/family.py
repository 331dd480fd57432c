"""A parametric family: its free parameters become features."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials.families import registry as families
from harness.materials.kinds.base import Kind, only, where_of


class Family(Kind):
    """``{name, type: family, family, fix, walks}``: the free parameters become features."""

    type = "family"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("family", "fix", "walks"))
        family, known = spec.get("family"), families.FAMILIES
        if family not in known:
            hint = nearest(str(family), known)
            raise InputError(f"{where_of(spec)}: family: unknown family {family!r}{hint}")
        fix = spec.get("fix", {})
        if not isinstance(fix, Mapping):
            raise InputError(f"{where_of(spec)}: fix: expected a mapping, got {fix!r}")
        known[family].check(fix, where_of(spec))
        if "walks" not in spec:
            return
        if not known[family].by_walks:
            raise InputError(f"{where_of(spec)}: walks: family '{family}' is in closed form")
        walks = spec["walks"]
        if not isinstance(walks, int) or isinstance(walks, bool) or walks < 1:
            where = f"{where_of(spec)}: walks"
            raise InputError(f"{where}: expected a whole number from 1, got {walks!r}")

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        family = spec["family"]
        fix = {key: float(value) for key, value in spec.get("fix", {}).items()}
        walks = {"walks": spec["walks"]} if "walks" in spec else {}
        return {"type": "family", "family": family, "fix": fix, **walks}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        options = {"walks": spec["walks"]} if "walks" in spec else {}
        family = families.FAMILIES[spec["family"]]
        return family.make(spec["name"], spec.get("fix", {}), what, **options)


KIND = Family()
