"""A Mitsuba BSDF: a dictionary in the suite, or one of an XML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError
from harness.core.protocol.material import Material
from harness.materials import mitsuba_values, xml_bsdf
from harness.materials.kinds.base import Kind, by_mitsuba, only, path_of, where_of
from harness.mitsuba_runtime import mitsuba_xml, python_plugins


class Mitsuba(Kind):
    """``{name, type: mitsuba, bsdf}`` or ``{name, type: mitsuba, file, id, parameters}``."""

    type = "mitsuba"

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        only(spec, ("bsdf", "file", "id", "parameters"))
        if ("bsdf" in spec) == ("file" in spec):
            raise InputError(f"{where_of(spec)}: expected either 'bsdf' or 'file'")
        if "file" in spec:
            if not isinstance(spec.get("id", ""), str):
                raise InputError(f"{where_of(spec)}: id: expected a text, got {spec['id']!r}")
            self._found(spec, base)
            return
        for key in ("id", "parameters"):
            if key in spec:
                raise InputError(f"{where_of(spec)}: '{key}' goes with 'file', not with 'bsdf'")
        if not isinstance(spec["bsdf"], Mapping):
            raise InputError(f"{where_of(spec)}: bsdf: expected a mapping, got {spec['bsdf']!r}")
        self._checked(spec, base)

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        if "file" in spec:
            content = self._found(spec, base)[0].content_hash()
            return {"type": "mitsuba", "xml": content, "id": spec.get("id", "")}
        hashed = mitsuba_values.replaced(
            self._checked(spec, base), mitsuba_xml.file_hash, python_plugins.identity
        )
        return {"type": "mitsuba", "bsdf": hashed}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return by_mitsuba(spec, what, lambda: self._bsdf(spec, base))

    def _bsdf(self, spec: Mapping[str, Any], base: Path) -> Any:
        from harness.materials.mitsuba_bsdf import mitsuba

        mitsuba()  # sets the variant
        if "file" in spec:
            return xml_bsdf.load(
                path_of(spec, base), spec.get("id"), where_of(spec), spec.get("parameters")
            )
        checked = mitsuba_values.replaced(
            self._checked(spec, base),
            lambda file, where: str(file),
            lambda plugin: python_plugins.register(plugin, where_of(spec)),
        )
        return mitsuba_values.mitsuba_values(checked)

    @staticmethod
    def _checked(spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return mitsuba_values.checked(spec["bsdf"], f"{where_of(spec)}: bsdf", base)

    @staticmethod
    def _found(spec: Mapping[str, Any], base: Path) -> tuple[mitsuba_xml.MitsubaFile, int]:
        return xml_bsdf.find(
            path_of(spec, base), spec.get("id"), where_of(spec), spec.get("parameters")
        )


KIND = Mitsuba()
