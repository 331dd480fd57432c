"""A scene's list of effects with one more or one less; and all that it could have."""

from __future__ import annotations

from collections.abc import Sequence

from harness.effects.base import LIGHTS, Offer
from harness.effects.registry import EFFECTS, parse, refusals

DEEPEST = 12
"""Bounces that stand for full global illumination (NeuSample, Figure 11)."""


def name_of(text: str) -> str:
    """``indirect`` of ``indirect: 12``."""
    return text.partition(":")[0]


def explicit(effects: Sequence[str], offer: Offer) -> tuple[str, ...]:
    """The list with the material's running effects named, and ``colour`` too.

    ``material: plain`` stays where nothing of the material runs and it has something that could.
    """
    own = offer.material or frozenset()
    named = {e.name for e in parse(effects) if e.own}
    kept = [t for t in effects if not EFFECTS[name_of(t)].own and name_of(t) != "material"]
    if "colour" not in map(name_of, kept):
        kept.append("colour: rgb")
    whole = not named and "material: plain" not in effects
    running = sorted(own if whole else named)
    if not running and own:
        running = ["material: plain"]
    return (*kept, *running)


def full(offer: Offer) -> tuple[str, ...]:
    """Everything that the scene has and the material can give, in three channels."""
    found = [light for light in LIGHTS if light in offer.lights]
    found += ["emitter-sampling", f"indirect: {DEEPEST}", "depth-of-field", "media", "colour: rgb"]
    found += [n for n, effect in EFFECTS.items() if effect.own and n != "media"]
    return tuple(text for text in found if not refusals([text], offer))


def without(effects: Sequence[str], name: str, offer: Offer) -> tuple[str, ...]:
    """An :func:`explicit` list less the effect ``name``; less colour is one channel."""
    if name == "colour":
        return replaced(effects, "colour: luminance")
    rest = tuple(text for text in effects if name_of(text) != name)
    left = any(EFFECTS[name_of(text)].own for text in rest)
    if EFFECTS[name].own and not left and offer.material:
        rest = (*rest, "material: plain")
    return rest


def replaced(effects: Sequence[str], text: str) -> tuple[str, ...]:
    """The list with ``text`` in place of whatever it said of that effect, or added to it."""
    effect = EFFECTS[name_of(text)]
    gone = {name_of(text)} | ({"material"} if effect.own else set())
    return (*(t for t in effects if name_of(t) not in gone), text)


def with_one_more(effects: Sequence[str], offer: Offer) -> dict[str, tuple[str, ...]]:
    """By name: the list with each effect that it lacks and could have.

    A light that needs ``emitter-sampling`` brings it along.
    """
    there = {name_of(text) for text in effects}
    found: dict[str, tuple[str, ...]] = {}
    for text in full(offer):
        name = name_of(text)
        if name in there:
            continue
        more = replaced(effects, text)
        needed = EFFECTS[name].needs
        if needed and needed not in there:
            more = replaced(more, needed)
        found[name] = more
    return found


def lit(effects: Sequence[str]) -> bool:
    """Whether any light is left."""
    return any(name_of(text) in LIGHTS for text in effects)
