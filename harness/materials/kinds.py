"""The kinds of material that a mapping can ask for, by its ``type``; see ``registry.py``.

Neither Mitsuba nor Dr.Jit is loaded before one is made.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials import measured, xml_bsdf
from harness.materials.families import registry as families
from harness.materials.hard import registry as hard
from harness.materials.neural import files as neural
from harness.microgeometry import btf_file
from harness.mitsuba_runtime import mitsuba_xml


class Kind(ABC):
    """One ``type``. Specifications have a name; relative files are meant from ``base``."""

    @abstractmethod
    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        """Raise :class:`InputError` if ``spec`` cannot be followed, as far as files tell."""

    @abstractmethod
    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        """What determines the reflectance, of a valid ``spec``."""

    @abstractmethod
    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        """The material of a valid ``spec``; ``what`` is its identity."""


class Measured(Kind):
    """``{name, type: measured, file}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        measured.check(_path(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        file = mitsuba_xml.file_hash(_path(spec, base), where_of(spec))
        return {"type": "measured", "sha256": file}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return _by_mitsuba(spec, what, lambda: measured.bsdf(_path(spec, base)))


class Mitsuba(Kind):
    """``{name, type: mitsuba, bsdf}`` or ``{name, type: mitsuba, file, id}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("bsdf", "file", "id"))
        if ("bsdf" in spec) == ("file" in spec):
            raise InputError(f"{where_of(spec)}: expected either 'bsdf' or 'file'")
        if "file" in spec:
            if not isinstance(spec.get("id", ""), str):
                raise InputError(f"{where_of(spec)}: id: expected a text, got {spec['id']!r}")
            xml_bsdf.find(_path(spec, base), spec.get("id"), where_of(spec))
            return
        if "id" in spec:
            raise InputError(f"{where_of(spec)}: 'id' goes with 'file', not with 'bsdf'")
        if not isinstance(spec["bsdf"], Mapping):
            raise InputError(f"{where_of(spec)}: bsdf: expected a mapping, got {spec['bsdf']!r}")
        self._walk(spec["bsdf"], f"{where_of(spec)}: bsdf", base, lambda path, _: path)

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        if "file" in spec:
            content = mitsuba_xml.content_hash(_path(spec, base), where_of(spec))
            return {"type": "mitsuba", "xml": content, "id": spec.get("id", "")}
        where = f"{where_of(spec)}: bsdf"
        hashed = self._walk(spec["bsdf"], where, base, mitsuba_xml.file_hash)
        return {"type": "mitsuba", "bsdf": hashed}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return _by_mitsuba(spec, what, lambda: self._bsdf(spec, base))

    def _bsdf(self, spec: Mapping[str, Any], base: Path) -> Any:
        if "bsdf" in spec:
            absolute = self._walk(spec["bsdf"], "", base, lambda path, _: str(path.resolve()))
            return _mitsuba_values(absolute)
        from harness.materials.mitsuba_bsdf import _mi

        _mi()  # sets the variant
        return xml_bsdf.load(_path(spec, base), spec.get("id"), where_of(spec))

    def _walk(self, node: Any, where: str, base: Path, on_file: Callable[[Path, str], Any]) -> Any:
        """A copy of a dictionary of JSON data with ``on_file`` in place of each file name."""
        if isinstance(node, Mapping):
            if not isinstance(node.get("type"), str):
                raise InputError(f"{where}: expected the key 'type' to name a Mitsuba plugin")
            found = {}
            for key, value in node.items():
                if not isinstance(key, str):
                    raise InputError(f"{where}: expected a text as key, got {key!r}")
                here = f"{where}.{key}"
                if key == "filename":
                    if not isinstance(value, str) or not (base / value).is_file():
                        raise InputError(f"{here}: no such file: {value}")
                    found[key] = on_file(base / value, here)
                else:
                    found[key] = self._walk(value, here, base, on_file)
            return found
        if isinstance(node, list) and all(_is_number(item) for item in node):
            return list(node)
        if isinstance(node, (str, bool)) or _is_number(node):
            return node
        raise InputError(
            f"{where}: expected a number, a text, true, false, a list of numbers or a mapping,"
            f" got {node!r}"
        )


class Btf(Kind):
    """``{name, type: btf, file}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        btf_file.check(_path(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        file = mitsuba_xml.file_hash(_path(spec, base), where_of(spec))
        return {"type": "btf", "sha256": file}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        from harness.materials.btf import BtfMaterial

        return BtfMaterial(spec["name"], _path(spec, base), what)


class Hard(Kind):
    """``{name, type: hard}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ())
        name = spec["name"]
        if name not in hard.MATERIALS:
            raise InputError(f"unknown hard material '{name}'{nearest(name, hard.MATERIALS)}")

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        name = spec["name"]
        return {"type": "hard", "name": name}

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return hard.MATERIALS[spec["name"]].make(spec["name"], what)


class Family(Kind):
    """``{name, type: family, family, fix, walks}``: the free parameters become features."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("family", "fix", "walks"))
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


class Neural(Kind):
    """``{name, type: neural, file}``; without a file, the shipped one of that name."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        neural.check(self._file(spec, base), where_of(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return neural.identity(self._file(spec, base), where_of(spec))

    def make(self, spec: Mapping[str, Any], base: Path, what: dict[str, Any]) -> Material:
        return neural.make(spec["name"], self._file(spec, base), what)

    @staticmethod
    def _file(spec: Mapping[str, Any], base: Path) -> Path:
        """The file that a specification means."""
        if "file" in spec:
            return _path(spec, base)
        known = neural.shipped()
        if spec["name"] not in known:
            raise InputError(
                f"unknown neural material '{spec['name']}'{nearest(spec['name'], known)}"
            )
        return known[spec["name"]]


KINDS: dict[str, Kind] = {
    "mitsuba": Mitsuba(),
    "measured": Measured(),
    "btf": Btf(),
    "hard": Hard(),
    "family": Family(),
    "neural": Neural(),
}


# --- helpers ---------------------------------------------------------------------------


def where_of(spec: Mapping[str, Any]) -> str:
    """What a message calls the specification."""
    return f"material '{spec['name']}'"


def _only(spec: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in spec:
        if key not in ("name", "type", *keys):
            hint = nearest(str(key), ("name", "type", *keys))
            raise InputError(f"{where_of(spec)}: unknown key '{key}'{hint}")


def _path(spec: Mapping[str, Any], base: Path) -> Path:
    value = spec.get("file")
    if not isinstance(value, str) or not value:
        raise InputError(f"{where_of(spec)}: file: expected the name of a file, got {value!r}")
    return base / value


def _by_mitsuba(spec: Mapping[str, Any], what: dict[str, Any], bsdf: Callable[[], Any]) -> Material:
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    return MitsubaMaterial(spec["name"], bsdf(), what, bsdf)


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _mitsuba_values(node: Any) -> Any:
    """A list of three numbers is a colour in a suite's dictionary."""
    if isinstance(node, Mapping):
        if node.get("type") in ("rgb", "srgb"):
            return dict(node)
        return {key: _mitsuba_values(value) for key, value in node.items()}
    if isinstance(node, list):
        return {"type": "rgb", "value": node}
    return node
