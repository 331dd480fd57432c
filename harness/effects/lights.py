"""Which lights are built, and whether a ray is sent to them on purpose."""

from __future__ import annotations

from dataclasses import replace

from harness.effects.base import Effect, Offer, Recipe


class Light(Effect):
    """A kind of light; one that is not called for is not built."""

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, lights=recipe.lights | {self.name})

    def lacking(self, offer: Offer) -> str:
        """See :meth:`Effect.lacking`."""
        if self.name in offer.lights:
            return ""
        has = ", ".join(sorted(offer.lights)) or "none"
        return f"the scene '{offer.scene}' has no such light (its lights: {has})"


class Environment(Light):
    """Light from infinitely far away, constant or a map."""

    name = "environment"
    about = "light from the environment, constant or a map"


class AreaLights(Light):
    """Shapes that emit; the shape goes with its light."""

    name = "area-lights"
    about = "lamps with a surface"


class PointLights(Light):
    """Lights without extent, which no sample of a BSDF ever meets."""

    name = "point-lights"
    about = "lights without extent: points, spots, parallel beams"
    needs = "emitter-sampling"


class EmitterSampling(Effect):
    """Next-event estimation, weighted by the power heuristic against the BSDF's sampler.

    Costs a shadow ray, an evaluation and a pdf query at every shading point.
    """

    name = "emitter-sampling"
    about = "samples of the lights, weighted against the BSDF's by their pdfs (MIS)"

    def add(self, recipe: Recipe) -> Recipe:
        """See :meth:`Effect.add`."""
        return replace(recipe, emitter_sampling=True)
