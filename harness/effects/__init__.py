"""Effects: what a scene calls for, and what has to be built, traced and evaluated for it.

An effect is one small object (:class:`Effect`); the registry reads a scene's list of them and
makes one :class:`Recipe`, from which a renderer builds. Plain data: no renderer is loaded here.
"""

from harness.effects.base import Effect, Offer, Recipe
from harness.effects.offer import offer, recipe_of, require_of
from harness.effects.registry import EFFECTS, checked, is_auto, parse, recipe, refusals

__all__ = [
    "EFFECTS",
    "Effect",
    "Offer",
    "Recipe",
    "checked",
    "is_auto",
    "offer",
    "parse",
    "recipe",
    "recipe_of",
    "refusals",
    "require_of",
]
