"""What an effect is, and the recipe that effects make together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

Integrator = Literal["direct", "path", "volpath"]
LIGHTS = ("environment", "area-lights", "point-lights")
"""The kinds of light, by the effects that build them."""


@dataclass(frozen=True)
class Recipe:
    """What to build. Without any effect: no light at all, and one bounce.

    ``bounces`` is how often light may scatter at surfaces on its way to the camera; 1 is direct
    light. ``material`` are the material's own effects that run, None for all it has. ``paths``
    is no effect: it asks for a path tracer even where direct light is all, so that an image can
    be compared with one of more bounces from the same random numbers.
    """

    lights: frozenset[str] = frozenset()
    bounces: int = 1
    emitter_sampling: bool = False
    media: bool = False
    lens: bool = False
    channels: int = 3
    material: frozenset[str] | None = None
    paths: bool = False

    @property
    def integrator(self) -> Integrator:
        """The leanest of Mitsuba's integrators that has all of it."""
        if self.media:
            return "volpath"
        return "path" if self.bounces > 1 or self.paths else "direct"

    def of(self, own: frozenset[str]) -> frozenset[str]:
        """Which of a material's ``own`` effects run."""
        return own if self.material is None else own & self.material

    def running(self, name: str) -> Recipe:
        """The recipe with the material's effect ``name`` too, and none that was not named."""
        return replace(self, material=(self.material or frozenset()) | {name})


@dataclass(frozen=True)
class Offer:
    """What a scene has, and what the material in it can give (None: no material is known yet)."""

    scene: str
    lights: frozenset[str]
    lens: bool = False
    media: bool = False
    material: frozenset[str] | None = None
    material_name: str = ""


@dataclass(frozen=True)
class Effect:
    """One effect, with its parameter where it has one.

    ``needs`` names an effect without which it would do nothing. Subclasses say in
    :meth:`add` what they add to a recipe and in :meth:`lacking` what they need of the scene and
    the material.
    """

    name: ClassVar[str] = ""
    about: ClassVar[str] = ""
    needs: ClassVar[str] = ""
    own: ClassVar[bool] = False
    """Whether it is the material's, and not the light's way."""

    @classmethod
    def read(cls, value: Any) -> Effect:
        """The effect from what follows its name in YAML, None if nothing does.

        Raises:
            ValueError: what was expected instead.
        """
        if value is not None:
            raise ValueError(f"takes no value, got {value!r}")
        return cls()

    def __str__(self) -> str:
        """As written in a scene: ``name`` or ``name: value``."""
        return self.name

    def add(self, recipe: Recipe) -> Recipe:
        """``recipe`` with this effect."""
        raise NotImplementedError

    def lacking(self, offer: Offer) -> str:
        """Why the scene or the material cannot give it; "" if they can."""
        return ""
