"""What a scene has and a material gives, as effects ask for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from harness.core.protocol.material import Material
from harness.effects.base import Offer, Recipe
from harness.effects.registry import recipe, require


def offer(scene: Any, material: Material | None = None) -> Offer:
    """Of a :class:`~harness.scenes.base.Scene` or ``XmlScene``, and of the material in it."""
    own = {} if material is None else {"material": material.effects}
    name = "" if material is None else f"'{material.name}'"
    return Offer(
        scene.name, scene.lights, scene.camera_has_lens, scene.media, material_name=name, **own
    )


def recipe_of(scene: Any) -> Recipe:
    """What is to be built for a scene: media need an integrator only where it has some."""
    made = recipe(scene.effects)
    return replace(made, media=made.media and scene.media)


def require_of(scene: Any, material: Material | None = None) -> None:
    """Refuse a scene whose effects it or the material cannot give.

    Raises:
        InputError: with the reason.
    """
    require(scene.effects, offer(scene, material), f"scene '{scene.name}'")
