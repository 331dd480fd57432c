"""Finds materials: the named ones, a user's Mitsuba dictionary or XML file, a measured file.

A specification is a name, or a mapping::

    {name: paint,     type: measured, file: paint.bsdf}
    {name: clearcoat, type: mitsuba,  bsdf: {type: principled, roughness: 0.2}}
    {name: theirs,    type: mitsuba,  file: scene.xml, id: wood}
    {name: carpet,    type: btf,      file: carpet.btf}
    {name: rim-lobe,  type: hard}    # or its name alone: see harness.materials.hard
    {name: polished,  type: family,   family: disney, fix: {roughness: 0.1}}   # or disney alone
    {name: brushed,   type: family,   family: ggx-conductor, walks: 64}  # f: mean over 64 walks
    {name: theirs,    type: neural,   file: theirs.ckpt}       # see harness.materials.neural

Relative files are meant from ``base_dir`` (the folder of the suite), or the working folder.
Neither Mitsuba nor Dr.Jit is loaded before :func:`make`.
"""

from __future__ import annotations

import ast
import importlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from harness import mitsuba_xml
from harness.materials import families, hard, measured, xml_bsdf
from harness.materials.neural import files as neural
from harness.microgeometry import btf_file
from harness.protocol import InputError, Material, nearest
from harness.source import covered, digest

LIBRARY = Path(__file__).parent / "library"
PACKAGE = "harness.materials.library"

Spec = str | Mapping[str, Any]


def names() -> list[str]:
    """Names of the procedural materials, sorted."""
    return sorted(_named())


def hard_names() -> list[str]:
    """Names of the materials that are hard on purpose, in the order of their files."""
    return list(hard.MATERIALS)


def family_names() -> list[str]:
    """Names of the parametric families, sorted."""
    return sorted(families.FAMILIES)


def neural_names() -> list[str]:
    """Names of the neural materials that come with the harness, sorted."""
    return list(neural.shipped())


def describe(name: str) -> str:
    """One line about a named material, beginning with the regime it stands for."""
    if name in families.FAMILIES:
        return families.FAMILIES[name].about
    if name in neural.shipped():
        return neural.describe(neural.shipped()[name])
    if name in hard.MATERIALS:
        return hard.MATERIALS[name].about
    for node in ast.parse(_file(name).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "SUMMARY":
            return str(ast.literal_eval(node.value))
    raise AssertionError(f"{_file(name)} has no SUMMARY")


def validate(spec: Spec, base_dir: Path | str | None = None) -> None:
    """Refuse a specification that :func:`make` could not follow, as far as files tell.

    Raises:
        InputError: with one line that says what is wrong.
    """
    spec = _in_full(spec)
    if isinstance(spec, str):
        _file(spec)
        return
    if not isinstance(spec, Mapping):
        raise InputError(f"material: expected a name or a mapping, got {spec!r}")
    name = spec.get("name")
    if not isinstance(name, str) or not name:
        raise InputError(f"material: name: expected a text, got {name!r}")
    if set(spec) == {"name"}:
        _file(name)
        return
    _kind(spec).validate(spec, _base(base_dir))


def identity(spec: Spec, base_dir: Path | str | None = None) -> dict[str, Any]:
    """What determines the reflectance, as JSON data: contents of files, never their paths.

    Validates first. The name of a user's material is a label and not part of it.
    """
    validate(spec, base_dir)
    spec = _in_full(spec)
    name = _bare_name(spec)
    if name is not None:
        return {"type": "named", "name": name, "source": digest(covered(_file(name), PACKAGE))}
    return _kind(spec).identity(spec, _base(base_dir))


def make(spec: Spec, base_dir: Path | str | None = None) -> Material:
    """The material; :class:`InputError` if the specification is refused."""
    what = identity(spec, base_dir)
    spec = _in_full(spec)
    if _is(spec, "hard"):
        return hard.MATERIALS[spec["name"]].make(spec["name"], what)
    if _is(spec, "family"):
        options = {"walks": spec["walks"]} if "walks" in spec else {}
        family = families.FAMILIES[spec["family"]]
        return family.make(spec["name"], spec.get("fix", {}), what, **options)
    if _is(spec, "btf"):
        from harness.materials.btf import BtfMaterial

        return BtfMaterial(spec["name"], _path(spec, _base(base_dir)), what)
    if _is(spec, "neural"):
        return neural.make(spec["name"], _Neural.file(spec, _base(base_dir)), what)
    # Imported here, for it loads Mitsuba.
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    name = _bare_name(spec)
    if name is not None:
        module = importlib.import_module(f"{PACKAGE}.{name.replace('-', '_')}")
        return MitsubaMaterial(name, module.bsdf(), what)
    assert isinstance(spec, Mapping)

    def bsdf() -> Any:
        return _kind(spec).bsdf(spec, _base(base_dir))

    return MitsubaMaterial(spec["name"], bsdf(), what, bsdf)


# --- the kinds -------------------------------------------------------------------------


class _Measured:
    """``{name, type: measured, file}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        measured.check(_path(spec, base), _where(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        file = mitsuba_xml.file_hash(_path(spec, base), _where(spec))
        return {"type": "measured", "sha256": file}

    def bsdf(self, spec: Mapping[str, Any], base: Path) -> Any:
        return measured.bsdf(_path(spec, base))


class _Mitsuba:
    """``{name, type: mitsuba, bsdf}`` or ``{name, type: mitsuba, file, id}``."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("bsdf", "file", "id"))
        if ("bsdf" in spec) == ("file" in spec):
            raise InputError(f"{_where(spec)}: expected either 'bsdf' or 'file'")
        if "file" in spec:
            if not isinstance(spec.get("id", ""), str):
                raise InputError(f"{_where(spec)}: id: expected a text, got {spec['id']!r}")
            xml_bsdf.find(_path(spec, base), spec.get("id"), _where(spec))
            return
        if "id" in spec:
            raise InputError(f"{_where(spec)}: 'id' goes with 'file', not with 'bsdf'")
        if not isinstance(spec["bsdf"], Mapping):
            raise InputError(f"{_where(spec)}: bsdf: expected a mapping, got {spec['bsdf']!r}")
        self._walk(spec["bsdf"], f"{_where(spec)}: bsdf", base, lambda path, _: path)

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        if "file" in spec:
            content = mitsuba_xml.content_hash(_path(spec, base), _where(spec))
            return {"type": "mitsuba", "xml": content, "id": spec.get("id", "")}
        where = f"{_where(spec)}: bsdf"
        hashed = self._walk(spec["bsdf"], where, base, mitsuba_xml.file_hash)
        return {"type": "mitsuba", "bsdf": hashed}

    def bsdf(self, spec: Mapping[str, Any], base: Path) -> Any:
        if "bsdf" in spec:
            absolute = self._walk(spec["bsdf"], "", base, lambda path, _: str(path.resolve()))
            return _mitsuba_values(absolute)
        from harness.materials.mitsuba_bsdf import _mi

        _mi()  # sets the variant
        return xml_bsdf.load(_path(spec, base), spec.get("id"), _where(spec))

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


class _Btf:
    """``{name, type: btf, file}``; :func:`make` makes it, for it is not Mitsuba's."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        btf_file.check(_path(spec, base), _where(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        file = mitsuba_xml.file_hash(_path(spec, base), _where(spec))
        return {"type": "btf", "sha256": file}


class _Hard:
    """``{name, type: hard}``; :func:`make` makes it, for not all are Mitsuba's."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ())
        name = spec["name"]
        if name not in hard.MATERIALS:
            raise InputError(f"unknown hard material '{name}'{nearest(name, hard.MATERIALS)}")

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        name = spec["name"]
        source = digest(covered(hard.MATERIALS[name].file, "harness.materials.hard"))
        return {"type": "hard", "name": name, "source": source}


class _Family:
    """``{name, type: family, family, fix, walks}``: the free parameters become features."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("family", "fix", "walks"))
        family, known = spec.get("family"), families.FAMILIES
        if family not in known:
            hint = nearest(str(family), known)
            raise InputError(f"{_where(spec)}: family: unknown family {family!r}{hint}")
        fix = spec.get("fix", {})
        if not isinstance(fix, Mapping):
            raise InputError(f"{_where(spec)}: fix: expected a mapping, got {fix!r}")
        known[family].check(fix, _where(spec))
        if "walks" not in spec:
            return
        if not known[family].by_walks:
            raise InputError(f"{_where(spec)}: walks: family '{family}' is in closed form")
        walks = spec["walks"]
        if not isinstance(walks, int) or isinstance(walks, bool) or walks < 1:
            where = f"{_where(spec)}: walks"
            raise InputError(f"{where}: expected a whole number from 1, got {walks!r}")

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        family = spec["family"]
        source = digest(covered(families.FAMILIES[family].file, families.PACKAGE))
        fix = {key: float(value) for key, value in spec.get("fix", {}).items()}
        walks = {"walks": spec["walks"]} if "walks" in spec else {}
        return {"type": "family", "family": family, "fix": fix, **walks, "source": source}


class _Neural:
    """``{name, type: neural, file}``; without a file, the shipped one of that name."""

    def validate(self, spec: Mapping[str, Any], base: Path) -> None:
        _only(spec, ("file",))
        neural.check(self.file(spec, base), _where(spec))

    def identity(self, spec: Mapping[str, Any], base: Path) -> dict[str, Any]:
        return neural.identity(self.file(spec, base), _where(spec))

    @staticmethod
    def file(spec: Mapping[str, Any], base: Path) -> Path:
        """The file that a specification means."""
        if "file" in spec:
            return _path(spec, base)
        known = neural.shipped()
        if spec["name"] not in known:
            raise InputError(
                f"unknown neural material '{spec['name']}'{nearest(spec['name'], known)}"
            )
        return known[spec["name"]]


KINDS: dict[str, Any] = {
    "mitsuba": _Mitsuba(),
    "measured": _Measured(),
    "btf": _Btf(),
    "hard": _Hard(),
    "family": _Family(),
    "neural": _Neural(),
}


# --- helpers ---------------------------------------------------------------------------


def _named() -> dict[str, Path]:
    return {
        file.stem.replace("_", "-"): file
        for file in LIBRARY.glob("*.py")
        if not file.name.startswith("_")
    }


def _file(name: str) -> Path:
    known = _named()
    if name not in known:
        others = [*hard.MATERIALS, *families.FAMILIES, *neural.shipped()]
        hint = nearest(name, [*known, *others])
        raise InputError(f"unknown material '{name}'{hint}")
    return known[name]


def _in_full(spec: Spec) -> Spec:
    """The bare name of a hard or neural material or a family with its type; else as it is."""
    bare = isinstance(spec, str) or (isinstance(spec, Mapping) and set(spec) == {"name"})
    name = spec if isinstance(spec, str) else spec["name"] if bare else None
    if isinstance(name, str) and name in hard.MATERIALS:
        return {"name": name, "type": "hard"}
    if isinstance(name, str) and name in families.FAMILIES:
        return {"name": name, "type": "family", "family": name}
    if isinstance(name, str) and name in neural.shipped():
        return {"name": name, "type": "neural"}
    return spec


def _is(spec: Spec, kind: str) -> bool:
    return isinstance(spec, Mapping) and spec.get("type") == kind


def _bare_name(spec: Spec) -> str | None:
    """The name, if the specification is nothing else."""
    if isinstance(spec, str):
        return spec
    return spec["name"] if set(spec) == {"name"} else None


def _kind(spec: Spec) -> Any:
    assert isinstance(spec, Mapping)
    kind = spec.get("type")
    if kind is None:
        raise InputError(f"{_where(spec)}: expected the key 'type', one of {', '.join(KINDS)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{_where(spec)}: unknown type {kind!r}{nearest(str(kind), KINDS)}")
    return KINDS[kind]


def _where(spec: Mapping[str, Any]) -> str:
    return f"material '{spec['name']}'"


def _only(spec: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in spec:
        if key not in ("name", "type", *keys):
            hint = nearest(str(key), ("name", "type", *keys))
            raise InputError(f"{_where(spec)}: unknown key '{key}'{hint}")


def _base(base_dir: Path | str | None) -> Path:
    return Path(base_dir) if base_dir is not None else Path()


def _path(spec: Mapping[str, Any], base: Path) -> Path:
    value = spec.get("file")
    if not isinstance(value, str) or not value:
        raise InputError(f"{_where(spec)}: file: expected the name of a file, got {value!r}")
    return base / value


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
