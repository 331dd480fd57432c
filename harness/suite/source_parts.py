"""Where the code of a trial's parts begins: the units that :mod:`harness.identity` follows.

What is chosen by name from a table (a material's kind, an effect, a scene) is looked up here, and
the tables themselves are not followed: a new entry changes no trial.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from harness.core import registry
from harness.identity.digests import Digests, Part, SourceDigest
from harness.identity.tree import Tree
from harness.identity.verdict import ADAPTER, MATERIAL, MEASURE, SCENE, TRAINING

EVERY_TRIAL = (
    "harness.core.streams:generator",
    "harness.measures.fit:restore",
    "harness.suite.trials:stream_seed",
)
"""What the runner does to the numbers of every trial: seeds, and how a method is restored."""

SHARED_RUN = (
    "harness.analysis.process_pooling:pooled",
    "harness.analysis.process_pooling:disturbed",
)
"""Of timed measures: how the outcomes of several processes become one."""


def parts_of(
    known: Digests, name: str, material_spec: Any, kind: type, scene_part: Part | None = None
) -> dict[str, Part]:
    """Where the parts of a trial begin: adapter, material, measure and, if it has one, scene.

    ``name`` is the method's, ``kind`` the measure's class.
    """
    tree = known.tree
    parts = {
        ADAPTER: known.remembered(("method", name), lambda: method(tree, name)),
        MATERIAL: known.remembered(
            ("material", json.dumps(material_spec, sort_keys=True, default=str)),
            lambda: material(material_spec),
        ),
        MEASURE: known.remembered(("measure", kind), lambda: measure(tree, kind)),
    }
    if scene_part is not None:
        parts[SCENE] = scene_part
    return parts


def of_trial(known: Digests, parts: Mapping[str, Part], fits: bool) -> dict[str, SourceDigest]:
    """Digests of the ``parts`` of a trial.

    The trial that ``fits`` has the part ``training`` too, which in others is in the fitted state.
    """
    return known.of(parts, {TRAINING: (ADAPTER, "fit")} if fits else None)


def method(tree: Tree, name: str) -> Part:
    """The adapter called ``name``: the class, and of its methods what the rest of a trial calls."""
    found = registry.find(name)
    if not found.package:
        module = f"{tree.add_folder(found.file.parent)}.{found.file.stem}"
    else:
        top, _, below = found.package.partition(".")
        if top not in tree.roots:
            folder = found.file.parent
            for _ in below.split(".") if below else ():
                folder = folder.parent
            tree.roots[top] = folder
        inside = found.file.name == "__init__.py"
        module = found.package if inside else f"{found.package}.{found.file.stem}"
    return Part((f"{module}:{found.class_name}",))


def material(spec: Any) -> Part:
    """The evaluator of a material's specification (valid, as a suite has it)."""
    return Part(tuple(_material(spec)))


def scene(spec: Any, made: Any, materials: Iterable[Any] = ()) -> Part:
    """What makes a scene: ``made`` of ``spec``, with all its effects and the ``materials`` in it.

    ``materials`` are the specifications of what surrounds the material under test.
    """
    from harness.effects import registry as effects
    from harness.scenes import library, xml

    entries = ["harness.scenes.xml:make" if xml.is_xml(spec) else "harness.scenes.registry:make"]
    if not xml.is_xml(spec):
        name = spec if isinstance(spec, str) else spec.get("scene", spec.get("name"))
        entries.append(_place(library.SCENES[name]))
    if effects.is_auto(made.effects):
        entries += [_place(effect) for effect in effects.EFFECTS.values()]
        entries.append("harness.measures.auto:resolve")
    else:
        names = {effect.name for effect in effects.parse(made.effects)}
        entries += [_place(effects.EFFECTS[name]) for name in sorted(names)]
    for each in materials:
        entries += _material(each)
    return Part(tuple(dict.fromkeys(entries)))


def measure(tree: Tree, kind: type) -> Part:
    """A measure's class: what its ``run`` reaches, and what the runner does around it."""
    top = kind.__module__.partition(".")[0]
    if top not in tree.roots:  # one that a test or a user's package registered
        import sys

        file = Path(sys.modules[kind.__module__].__file__ or "")
        if "." in kind.__module__:
            tree.roots[top] = file.parents[kind.__module__.count(".") - 1]
        else:
            top = tree.add_folder(file.parent)
            return Part((f"{top}.{file.stem}:{kind.__qualname__}", *EVERY_TRIAL), ("run",))
    shared = SHARED_RUN if getattr(kind, "timed", False) else ()
    return Part((_place(kind), *EVERY_TRIAL, *shared), ("run",))


def _place(thing: Any) -> str:
    # A function made by another stands for what that one says.
    return f"{thing.__module__}:{thing.__qualname__.partition('.<locals>')[0]}"


def _material(spec: Any) -> list[str]:
    from harness.materials import registry as materials
    from harness.materials.families import registry as families
    from harness.materials.hard import registry as hard

    full = materials._in_full(spec)
    name = materials._bare_name(full)
    if name is not None:
        module = f"{materials.PACKAGE}.{name.replace('-', '_')}"
        return [f"{module}:bsdf", "harness.materials.mitsuba_bsdf:MitsubaMaterial"]
    assert isinstance(full, Mapping)
    entries = [f"{_place(type(materials.KINDS[full['type']]))}.make"]
    if full["type"] == "family":
        family = families.FAMILIES[full["family"]]
        entries.append(f"{families.PACKAGE}.{family.module}:{family.class_name}")
    elif full["type"] == "hard":
        entries.append(_place(hard.MATERIALS[full["name"]].make))
    return entries
