"""Everything that a suite describes, built once and rendered small: what would fail in a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from harness.core import registry
from harness.core.protocol.errors import InputError, Mistakes, Unsupported
from harness.core.protocol.material import Material
from harness.mitsuba_runtime.xml_file import checked
from harness.runner import preflight
from harness.suite.load import Loaded
from harness.suite.plan import make_plan
from harness.suite.schema import NamedSpec, Suite

SIDE = 8
"""Pixels across."""


def check(loaded: Loaded, device: str) -> None:
    """Build and render all that the suite describes itself, and plan every profile.

    Materials and scenes by name come with the harness; of those no more than the names are looked
    at, except where they meet what the suite describes.

    Raises:
        Mistakes: all that was refused, a line each.
    """
    found = _Rehearsal(loaded.suite)
    found.methods()
    materials, scenes = found.materials(), found.scenes()
    found.renders(materials, scenes)
    lines = [f"{loaded.path}: {line}" for line in found.mistakes]
    for profile in loaded.suite.profiles or (None,):
        try:
            plan = make_plan(loaded, profile, device)
            preflight.check_report(plan)
            preflight.check_effects(plan, plan.trials)
        except InputError as error:
            # What is said of a material or scene by its place was said already.
            known = found.mistakes and _of_an_entry(str(error))
            if not known and not found.has_said(str(error)):
                lines.append(str(error))
    if lines:
        raise Mistakes(lines)


class _Rehearsal:
    def __init__(self, suite: Suite):
        self.suite = suite
        self.mistakes: list[str] = []
        self.said: dict[str, set[str]] = {}
        """What was refused, by what it is of."""

    def has_said(self, text: str) -> bool:
        """Whether one of the mistakes says this, too."""
        return any(said in text for every in self.said.values() for said in every)

    def methods(self) -> None:
        for spec in self.suite.methods:
            where = f"methods: '{spec.label}'"
            self._noted(where, lambda s=spec: registry.make(s.name, **s.params))

    def materials(self) -> dict[str, Material]:
        """Those that the suite describes, by name."""
        from harness.materials import registry as materials

        found = {}
        for i, item in enumerate(self.suite.materials):
            where, spec = f"materials[{i}]", _spec(item)
            if isinstance(spec, str):
                self._noted(where, lambda s=spec: materials.validate(s))
                continue
            made = self._noted(where, lambda s=spec: materials.make_tested(checked(s)))
            if made is not None:
                found[item.name] = made
        return found

    def scenes(self) -> dict[str, Any]:
        """All of them, by name."""
        from harness.scenes import registry as scenes

        made = {
            item.name: self._noted(f"scenes[{i}]", lambda x=item: scenes.make(checked(_spec(x))))
            for i, item in enumerate(self.suite.scenes)
        }
        return {name: scene for name, scene in made.items() if scene is not None}

    def renders(self, materials: dict[str, Material], scenes: dict[str, Any]) -> None:
        """Each described material in each scene, and each described scene with some material."""
        for item in self.suite.scenes:
            if item.name not in scenes:
                continue
            pairs = list(materials.values())
            if not pairs and item.rest():
                pairs = [_grey()]
            for material in pairs:
                where = f"scenes: '{item.name}' with '{material.name}'"
                scene = scenes[item.name]
                self._noted(where, lambda s=scene, m=material: _rendered(s, m), item.name)

    def _noted(self, where: str, make: Callable[[], Any], of: str = "") -> Any:
        """What ``make`` gives; None and one more mistake if it refuses or fails.

        What is wrong with a scene, which is ``of`` something, is said with one material alone.
        """
        try:
            return make()
        except (Exception, SystemExit) as error:
            known = isinstance(error, InputError | Unsupported)
            said = str(error) if known else registry.oneline(error)
            if not (of and said in self.said.get(of, ())):
                self.mistakes.append(f"{where}: {said}")
            self.said.setdefault(of, set()).add(said)
            return None


def _rendered(scene: Any, material: Material) -> None:
    """One sample of each of a few pixels, with the cosine."""
    from harness.effects.offer import offer
    from harness.effects.registry import is_auto
    from harness.effects.variants import full
    from harness.rendering.hit_check import is_seen
    from harness.rendering.prepared import prepare

    method = registry.make("cosine")
    method.bind(material)
    if is_auto(scene.effects):
        scene = replace(scene, effects=full(offer(scene, material)))
    ready = prepare(scene, material, method, SIDE)
    if not is_seen(ready.scene, ready.bsdf):
        raise InputError("no camera ray meets the material from a side that reflects")
    ready.render(1, 0)


def _grey() -> Material:
    from harness.materials import registry as materials

    return materials.make({"name": "grey", "type": "mitsuba", "bsdf": {"type": "diffuse"}})


def _spec(item: NamedSpec) -> Any:
    return {"name": item.name, **item.rest()} if item.rest() else item.name


def _of_an_entry(line: str) -> bool:
    """Whether a refusal is about an entry of a list, such as ``materials[2]``."""
    return any(f": {key}[" in line for key in ("materials", "scenes", "methods"))
