"""Finds materials: the named ones, a user's Mitsuba dictionary or XML file, a measured file.

A specification is a name, or a mapping::

    {name: paint,     type: measured, file: paint.bsdf}
    {name: clearcoat, type: mitsuba,  bsdf: {type: principled, roughness: 0.2}}
    {name: theirs,    type: mitsuba,  file: scene.xml, id: wood, parameters: {shine: 0.2}}
    {name: own,       type: mitsuba,  bsdf: {type: plugin.py:MyBSDF, alpha: 0.2}}
    {name: carpet,    type: btf,      file: carpet.btf}
    {name: rim-lobe,  type: hard}    # or its name alone: see harness.materials.hard
    {name: polished,  type: family,   family: disney, fix: {roughness: 0.1}}   # or disney alone
    {name: brushed,   type: family,   family: ggx-conductor, walks: 64}  # f: mean over 64 walks
    {name: theirs,    type: neural,   file: theirs.ckpt}       # see harness.materials.neural
    {name: grains,    type: puresample, file: grains.safetensors}  # learned from walks

Relative files are meant from ``base_dir`` (the folder of the suite), or the working folder.
Neither Mitsuba nor Dr.Jit is loaded before :func:`make`.
"""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.protocol.material import Material
from harness.materials import kinds, reflects
from harness.materials.families import registry as families
from harness.materials.hard import registry as hard
from harness.materials.kinds.base import Kind, where_of
from harness.materials.neural import files as neural
from harness.materials.puresample import files as puresample

LIBRARY = Path(__file__).parent / "library"
PACKAGE = "harness.materials.library"

Spec = str | Mapping[str, Any]


def _found_kinds() -> dict[str, Kind]:
    """The kind of every file of the folder that has one, by its type."""
    modules = (
        importlib.import_module(f"{kinds.__name__}.{item.name}")
        for item in pkgutil.iter_modules(kinds.__path__)
    )
    found = [module.KIND for module in modules if hasattr(module, "KIND")]
    return {kind.type: kind for kind in found}


KINDS = _found_kinds()


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


def puresample_names() -> list[str]:
    """Names of the materials learned from walks that come with the harness, sorted."""
    return list(puresample.shipped())


def describe(name: str) -> str:
    """One line about a named material, beginning with the regime it stands for."""
    if name in families.FAMILIES:
        return families.FAMILIES[name].about
    if name in neural.shipped():
        return neural.describe(neural.shipped()[name])
    if name in puresample.shipped():
        return puresample.describe(puresample.shipped()[name])
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
        return {"type": "named", "name": name}
    return _kind(spec).identity(spec, _base(base_dir))


def make(spec: Spec, base_dir: Path | str | None = None) -> Material:
    """The material; :class:`InputError` if the specification is refused."""
    what = identity(spec, base_dir)
    spec = _in_full(spec)
    name = _bare_name(spec)
    if name is None:
        return _kind(spec).make(spec, _base(base_dir), what)
    # Imported here, for it loads Mitsuba.
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    module = importlib.import_module(f"{PACKAGE}.{name.replace('-', '_')}")
    return MitsubaMaterial(name, module.bsdf(), what)


def make_tested(spec: Spec, base_dir: Path | str | None = None) -> Material:
    """:func:`make` of a material that is to be under test: one that reflects nothing is refused."""
    material = make(spec, base_dir)
    if isinstance(spec, Mapping) and ("file" in spec or "bsdf" in spec):
        reflects.check(material)
    return material


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
        others = [*hard.MATERIALS, *families.FAMILIES, *neural.shipped(), *puresample.shipped()]
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
    if isinstance(name, str) and name in puresample.shipped():
        return {"name": name, "type": "puresample"}
    return spec


def _bare_name(spec: Spec) -> str | None:
    """The name, if the specification is nothing else."""
    if isinstance(spec, str):
        return spec
    return spec["name"] if set(spec) == {"name"} else None


def _kind(spec: Spec) -> Kind:
    assert isinstance(spec, Mapping)
    kind = spec.get("type")
    if kind is None:
        raise InputError(f"{where_of(spec)}: expected the key 'type', one of {', '.join(KINDS)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{where_of(spec)}: unknown type {kind!r}{nearest(str(kind), KINDS)}")
    return KINDS[kind]


def _base(base_dir: Path | str | None) -> Path:
    return Path(base_dir) if base_dir is not None else Path()
