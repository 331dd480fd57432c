"""The effects by name, and a scene's list of them as one recipe.

A scene keeps its effects as it was told them, as texts: ``("environment", "indirect: 12")``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from harness.core.protocol.errors import InputError, nearest
from harness.core.yamlfile import parse_yaml
from harness.effects import lights, materials, transport
from harness.effects.auto import AUTO, read_auto
from harness.effects.base import LIGHTS, Effect, Offer, Recipe

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        lights.Environment,
        lights.AreaLights,
        lights.PointLights,
        lights.EmitterSampling,
        transport.Indirect,
        transport.DepthOfField,
        transport.Media,
        transport.Colour,
        materials.Texture,
        materials.Parallax,
        materials.Prefiltering,
        materials.MultipleScattering,
        materials.Whole,
    )
}


def checked(effects: Any, where: str) -> tuple[str, ...]:
    """A scene's effects as texts, without repeats, from what a suite or a scene file says.

    ``auto``, or ``{auto: TOLERANCE}``, stands alone: what is then called for is found out.

    Raises:
        InputError: no list of known effects, or one that calls for no light; ``where`` says
            whose.
    """
    if (tolerance := read_auto(effects, where)) is not None:
        return (f"{AUTO}: {tolerance:g}",)
    if isinstance(effects, str | Mapping) or not isinstance(effects, Iterable):
        raise InputError(f"{where}: effects: expected a list of names, or auto, got {effects!r}")
    found: dict[str, Effect] = {}
    for item in effects:
        effect = _one(item, where)
        if found.setdefault(effect.name, effect) != effect:
            raise InputError(
                f"{where}: effects: '{found[effect.name]}' and '{effect}' contradict each other"
            )
    _refuse_what_makes_no_sense(found, where)
    return tuple(str(effect) for effect in found.values())


def parse(effects: Sequence[str]) -> list[Effect]:
    """The objects behind a scene's texts.

    Raises:
        InputError: ``auto``, which has to be resolved first, or an unknown effect.
    """
    if is_auto(effects):
        raise InputError("effects: 'auto' has to be resolved for a material before a render")
    return [_one(text, "effects") for text in effects]


def is_auto(effects: Sequence[str]) -> bool:
    """Whether the effects are still to be found."""
    return any(str(text).partition(":")[0] == AUTO for text in effects)


def recipe(effects: Sequence[str]) -> Recipe:
    """What ``effects`` make together."""
    made = Recipe()
    for effect in parse(effects):
        made = effect.add(made)
    return made


def refusals(effects: Sequence[str], offer: Offer) -> list[str]:
    """Why what is called for cannot be had, a line for each effect; none if all can."""
    if is_auto(effects):
        return []
    reasons = ((effect, effect.lacking(offer)) for effect in parse(effects))
    return [f"effect '{effect.name}': {reason}" for effect, reason in reasons if reason]


def require(effects: Sequence[str], offer: Offer, where: str) -> None:
    """Refuse effects that the scene, or the material in it, cannot give.

    Raises:
        InputError: the first of :func:`refusals`.
    """
    for reason in refusals(effects, offer)[:1]:
        raise InputError(f"{where}: {reason}")


def _one(item: Any, where: str) -> Effect:
    if isinstance(item, str) and ":" in item:
        # A scene's own text; its value is read as YAML would.
        name, _, value = item.partition(":")
        item = {name.strip(): parse_yaml(value, where)}
    if isinstance(item, Mapping) and len(item) == 1:
        name, value = next(iter(item.items()))
    else:
        name, value = item, None
    if not isinstance(name, str) or name not in EFFECTS:
        hint = nearest(str(name), [*EFFECTS, AUTO])
        raise InputError(f"{where}: unknown effect {name!r}{hint}")
    try:
        return EFFECTS[name].read(value)
    except ValueError as error:
        raise InputError(f"{where}: effect '{name}': {error}") from None


def _refuse_what_makes_no_sense(found: dict[str, Effect], where: str) -> None:
    if not any(name in LIGHTS for name in found):
        raise InputError(f"{where}: effects: expected at least one light: {', '.join(LIGHTS)}")
    for effect in found.values():
        if effect.needs and effect.needs not in found:
            raise InputError(
                f"{where}: effect '{effect.name}' does nothing without '{effect.needs}'"
            )
    own = [name for name, effect in found.items() if effect.own]
    if "material" in found and own:
        raise InputError(
            f"{where}: effects: '{found['material']}' and '{own[0]}' contradict each other"
        )
