"""How far light is followed, and what it passes on its way to the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from harness.effects.base import Effect, Offer, Recipe


@dataclass(frozen=True)
class Indirect(Effect):
    """Light that was scattered more than once, ``bounces`` times at most."""

    bounces: int = 2
    name = "indirect"
    about = "light scattered more than once; indirect: 12 follows it for twelve bounces"

    @classmethod
    def read(cls, value: Any) -> Indirect:
        """See :meth:`Effect.read`."""
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not whole or value < 2:
            raise ValueError(
                f"expected the most bounces, 2 or more, as indirect: 12, got {value!r}"
            )
        return cls(value)

    def __str__(self) -> str:
        return f"{self.name}: {self.bounces}"

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, bounces=self.bounces)


class Media(Effect):
    """Scattering between surfaces: the scene's own media, or those inside a layered material."""

    name = "media"
    about = "scattering in volumes, of the scene or inside the material"
    own = True

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`; only a scene that has media needs an integrator for them."""
        return replace(recipe.running(self.name), media=True)

    def lacking(self, offer: Offer) -> str:
        """See :meth:`Effect.lacking`."""
        if offer.media or offer.material is None or self.name in offer.material:
            return ""
        return f"neither the scene '{offer.scene}' nor {offer.material_name} has any"


class DepthOfField(Effect):
    """A lens of finite aperture in place of a pinhole."""

    name = "depth-of-field"
    about = "blur away from the focus, by the aperture of the scene's lens"

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, lens=True)

    def lacking(self, offer: Offer) -> str:
        """See :meth:`Effect.lacking`."""
        return "" if offer.lens else f"the camera of the scene '{offer.scene}' has no aperture"


@dataclass(frozen=True)
class Colour(Effect):
    """How many channels are carried along a path and asked of the material."""

    channels: str = "rgb"
    name = "colour"
    about = "colour: luminance carries one channel, the luminance of lights and materials"

    @classmethod
    def read(cls, value: Any) -> Colour:
        """See :meth:`Effect.read`."""
        if value not in ("rgb", "luminance"):
            raise ValueError(f"expected rgb or luminance, as colour: luminance, got {value!r}")
        return cls(value)

    def __str__(self) -> str:
        return f"{self.name}: {self.channels}"

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, channels=3 if self.channels == "rgb" else 1)
