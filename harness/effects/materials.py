"""What a material can do without.

A scene that names none of these leaves the material as it is. One that names any runs those
alone; ``material: plain`` runs none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from harness.effects.base import Effect, Offer, Recipe


class OwnEffect(Effect):
    """An effect that a material gives (``Material.effects``) or has not."""

    own = True

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return recipe.running(self.name)

    def lacking(self, offer: Offer) -> str:
        """See :meth:`Effect.lacking`."""
        if offer.material is None or self.name in offer.material:
            return ""
        gives = ", ".join(sorted(offer.material)) or "none of its own"
        return f"the material {offer.material_name} cannot give it (its effects: {gives})"


class Texture(OwnEffect):
    """Variation over the surface; without it textures are their mean."""

    name = "texture"
    about = "variation over the surface; without it textures are their mean"


class Parallax(OwnEffect):
    """The shift of texture coordinates with the view, such as a neural material's offset."""

    name = "parallax"
    about = "the shift of texture coordinates with the view (a neural material's offset)"


class Prefiltering(OwnEffect):
    """The material's average over a footprint, by level of detail."""

    name = "prefiltering"
    about = "the material's average over a pixel's footprint, by level of detail"


class MultipleScattering(OwnEffect):
    """Light that meets a microsurface, or layers, more than once."""

    name = "multiple-scattering"
    about = "light that meets a material's microsurface or layers more than once"


@dataclass(frozen=True)
class Whole(Effect):
    """All of the material's own effects, which is the default, or none of them."""

    which: str = "whole"
    name = "material"
    about = "material: plain runs none of the material's own effects; default whole"

    @classmethod
    def read(cls, value: Any) -> Whole:
        """See :meth:`Effect.read`."""
        if value not in ("whole", "plain"):
            raise ValueError(f"expected whole or plain, as material: plain, got {value!r}")
        return cls(value)

    def __str__(self) -> str:
        return f"{self.name}: {self.which}"

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, material=None if self.which == "whole" else frozenset())
