"""A scene ready to be rendered with one material and one method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import mitsuba as mi
import numpy as np

from harness.protocol import Material, Method, Unsupported
from harness.rendering import build, passes, plugin
from harness.scenes.base import Scene, XmlScene

MakeBSDF = Callable[[Material, Method], plugin.SampledBSDF]


@dataclass
class Prepared:
    """``render`` as often as wanted; ``mask`` [H, W] are the pixels that count."""

    scene: mi.Scene
    integrator: mi.Integrator
    bsdf: mi.BSDF
    symbolic: bool = False

    def render(self, spp: int, seed: int) -> passes.Pass:
        """``spp`` samples per pixel; see :func:`passes.render`."""
        return passes.render(self.scene, self.integrator, spp, seed, self.symbolic)

    @cached_property
    def mask(self) -> np.ndarray:
        """Pixels wholly on the tested material: silhouettes vary for reasons of their own."""
        return passes.coverage(self.scene, self.bsdf)


def prepare(
    scene: Scene | XmlScene,
    material: Material,
    method: Method,
    resolution: int,
    sampling: build.Sampling = "bsdf",
    bsdf: MakeBSDF = plugin.SampledBSDF,
) -> Prepared:
    """The scene with ``material`` sampled by ``method``: direct light.

    By BSDF samples alone (``sampling="bsdf"``), or by those and light samples, weighted by
    the method's pdf (``"mis"``). ``bsdf`` makes the BSDF of the pair.
    """
    if not isinstance(scene, XmlScene):
        placed = bsdf(material, method)
        return Prepared(build.build(scene, placed, resolution), build.integrator(sampling), placed)
    # The method is part of the key by identity: two fits of one method are two pairs.
    key = build.scene_key(str(scene.file), material.name, method.name, str(id(method)))
    plugin.offer(key, lambda: bsdf(material, method))
    loaded = build.build_xml(scene, key, resolution)
    placed = next(s.bsdf() for s in loaded.shapes() if isinstance(s.bsdf(), plugin.SampledBSDF))
    return Prepared(loaded, build.integrator(sampling), placed)


def prepare_native(
    scene: Scene, material: Material, resolution: int, sampling: build.Sampling = "mis"
) -> Prepared:
    """The scene with the material's own BSDF, sampler and Mitsuba's default execution.

    Nothing of the harness takes part in the render, so it serves as an independent
    reference image (``sampling="mis"``, which reaches also what the BSDF's sampler does
    not) and as a yardstick of speed (``sampling="bsdf"``).

    Raises:
        Unsupported: the material is not a Mitsuba BSDF, or the scene is a file.
    """
    bsdf = getattr(material, "bsdf", None)
    if bsdf is None:
        raise Unsupported(f"material '{material.name}' is no Mitsuba BSDF")
    if isinstance(scene, XmlScene):
        raise Unsupported("a scene of the user's file is rendered with the harness's BSDF only")
    return Prepared(
        build.build(scene, bsdf, resolution), build.integrator(sampling), bsdf, symbolic=True
    )
