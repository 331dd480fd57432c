"""A scene ready to be rendered with one material and one method."""

from __future__ import annotations

import contextlib
import json
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from harness.core.protocol import counting
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.effects.base import Recipe
from harness.effects.offer import recipe_of, require_of
from harness.geometry.primitives import MaterialSpec
from harness.materials import registry as materials
from harness.rendering import build, counted_light, hit_check, passes, plugin
from harness.rendering.build_xml import build_xml
from harness.rendering.effect_wrapper import EffectWrapper, needed
from harness.rendering.meter import Meter
from harness.scenes.base import TESTED, Scene, XmlScene

MakeBSDF = Callable[[Material, Method], plugin.SampledBSDF]
Sampling = Literal["bsdf", "mis"]
_EMITTER_SAMPLING = {"bsdf": False, "mis": True}

# Materials around the one under test, as long as a scene that is alive uses them.
_around: weakref.WeakValueDictionary[str, Material] = weakref.WeakValueDictionary()


@dataclass
class Prepared:
    """``render`` as often as wanted; ``mask`` [H, W] are the pixels that count.

    ``symbolic``: as one kernel, Mitsuba's default; otherwise in evaluated mode, see
    :func:`passes.evaluated_mode`.
    """

    scene: mi.Scene
    integrator: mi.Integrator
    bsdf: mi.BSDF
    symbolic: bool = False
    recipe: Recipe = Recipe()
    meter: Meter | None = None
    kept: tuple[Material, ...] = ()
    """Materials of other shapes: they are shared with scenes built while this one lives."""

    def render(self, spp: int, seed: int) -> passes.Pass:
        """``spp`` samples per pixel; see :func:`passes.render`."""
        with counting.into(self.meter.counts) if self.meter else contextlib.nullcontext():
            return passes.render(self.scene, self.integrator, spp, seed, self._as_one_kernel())

    def _as_one_kernel(self) -> bool:
        """A meter needs call by call."""
        return self.symbolic and getattr(self.bsdf, "meter", None) is None

    @cached_property
    def mask(self) -> np.ndarray:
        """Pixels wholly on the tested material: silhouettes vary for reasons of their own."""
        return passes.coverage(self.scene, self.bsdf)


def prepare(
    scene: Scene | XmlScene,
    material: Material,
    method: Method,
    resolution: int,
    sampling: Sampling | None = None,
    bsdf: MakeBSDF = plugin.SampledBSDF,
    meter: Meter | None = None,
    paths: bool = False,
) -> Prepared:
    """The scene with ``material`` sampled by ``method``, and what its effects call for.

    ``sampling`` overrules whether lights are sampled: by BSDF samples alone (``"bsdf"``), or
    by those and light samples, weighted by the method's pdf (``"mis"``). ``bsdf`` makes the
    BSDF of the pair. A ``meter`` counts what all surfaces and lights are asked for, which
    takes time. ``paths`` has direct light rendered by a path tracer too, which draws the random
    numbers that it would draw for more bounces.

    Raises:
        InputError: an effect that the scene or the material cannot give.
        Unsupported: the material's BSDF reads more of the scene than its conditions carry.
    """
    recipe = replace(_recipe(scene, material, sampling), paths=paths)
    material, method = _reduced(material, method, recipe)
    placed = bsdf(material, method)
    placed.follow(recipe, meter)
    ready = _placed(scene, placed, resolution, recipe, meter)
    hit_check.check(ready.scene, placed)
    return ready


def prepare_native(
    scene: Scene | XmlScene,
    material: Material,
    resolution: int,
    sampling: Sampling | None = "mis",
) -> Prepared:
    """The scene with the material's own BSDF, sampler and Mitsuba's default execution.

    Nothing of the harness takes part in the render, so it serves as an independent
    reference image (``sampling="mis"``, which reaches also what the BSDF's sampler does
    not) and as a yardstick of speed (``"bsdf"``, or None for what the scene calls for).

    Raises:
        Unsupported: the material is not a Mitsuba BSDF.
    """
    recipe = _recipe(scene, material, sampling)
    material = material.with_effects(recipe.of(material.effects))
    bsdf = material.mitsuba_bsdf()
    if bsdf is None:
        raise Unsupported(f"material '{material.name}' is no Mitsuba BSDF")
    placed = EffectWrapper(bsdf, recipe) if needed(recipe, None) else bsdf
    return replace(_placed(scene, placed, resolution, recipe, None), symbolic=True)


def _recipe(scene: Scene | XmlScene, material: Material, sampling: Sampling | None) -> Recipe:
    require_of(scene, material)
    recipe = recipe_of(scene)
    if sampling is None:
        return recipe
    return replace(recipe, emitter_sampling=_EMITTER_SAMPLING[sampling])


def _reduced(material: Material, method: Method, recipe: Recipe) -> tuple[Material, Method]:
    """Both without the material's effects that are not called for; the fit stays as it is."""
    wanted = recipe.of(material.effects)
    if wanted == material.effects:
        return material, method
    material = material.with_effects(wanted)
    return material, method.rebound(material)


def _placed(
    scene: Scene | XmlScene,
    placed: mi.BSDF,
    resolution: int,
    recipe: Recipe,
    meter: Meter | None,
) -> Prepared:
    """The scene with ``placed`` on what is tested, and other materials around it."""
    kept: list[Material] = []
    made: dict[str, mi.BSDF] = {}

    def around(spec: MaterialSpec | None) -> mi.BSDF:
        key = json.dumps(spec, sort_keys=True)
        if key not in made:
            kept.append(_material(key, spec))
            made[key] = _bsdf(kept[-1], recipe, meter)
        return made[key]

    if isinstance(scene, XmlScene):
        bsdfs = {
            key: placed if spec == TESTED else around(spec)
            for key, spec in scene.replace_bsdf.items()
        }

        def wrapper(nested: mi.BSDF) -> EffectWrapper:
            return EffectWrapper(nested, recipe, meter)

        wrap = wrapper if needed(recipe, meter) else None
        loaded = build_xml(scene, bsdfs, resolution, recipe, wrap, meter is not None)
    else:
        loaded = build.build(scene, placed, resolution, recipe, around, meter is not None)
    if meter is not None:
        for light in loaded.emitters():
            assert isinstance(light, counted_light.CountedLight)
            light.meter = meter
    for bsdf in (placed, *made.values()):
        if isinstance(bsdf, plugin.SampledBSDF):
            bsdf.spread = pixel_angle(loaded.sensors()[0])
    integrator = build.integrator(recipe)
    ours = [b for b in (placed, *made.values()) if isinstance(b, plugin.SampledBSDF)]
    symbolic = meter is None and all(b.symbolic for b in ours)
    return Prepared(loaded, integrator, placed, symbolic, recipe, meter, tuple(kept))


def pixel_angle(sensor: mi.Sensor) -> float:
    """Radians between the rays of two neighbouring pixels in the middle of the picture."""
    step = 1 / int(sensor.film().crop_size()[0])
    rays = [
        sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5 + shift, 0.5), mi.Point2f(0.5))[0]
        for shift in (0.0, step)
    ]
    return float(dr.norm(dr.cross(rays[0].d, rays[1].d))[0])


def _material(key: str, spec: MaterialSpec | None) -> Material:
    if key not in _around:
        grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.3}}
        made = materials.make(spec or {"name": "grey", "type": "mitsuba", "bsdf": grey})
        _around[key] = made
        return made
    return _around[key]


def _bsdf(material: Material, recipe: Recipe, meter: Meter | None) -> mi.BSDF:
    """The BSDF of a material that is not under test: its own, or sampled by the cosine."""
    material = material.with_effects(recipe.of(material.effects))
    own = material.mitsuba_bsdf()
    if own is not None:
        return EffectWrapper(own, recipe, meter) if needed(recipe, meter) else own
    from harness.core import registry

    native = registry.make("native")
    method = native if native.supports(material)[0] else registry.make("cosine")
    method.bind(material)
    placed = plugin.SampledBSDF(material, method)
    placed.follow(recipe, meter)
    return placed
