"""An effect that is not needed changes no pixel when it is left out; one that is needed does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from harness.core import registry
from harness.core.protocol.material import Material
from harness.mitsuba_runtime import variant
from harness.scenes.base import Scene
from harness.stats.ztest import agreement
from tests.effect_fakes import Offset, hall, without_lens

variant.use("cpu")

from harness.materials.mitsuba_bsdf import MitsubaMaterial  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402

SIDE, SPP = 16, 256
ALPHA = 1e-3
LIGHTS = ("environment", "area-lights", "point-lights", "emitter-sampling")


def grey() -> Material:
    return MitsubaMaterial(
        "grey", {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}, {"type": "test"}
    )


def tiles(contrast: float) -> Material:
    """Lambertian tiles."""
    texels = np.full((8, 8, 3), 0.5, np.float32)
    texels[::2] += contrast
    bitmap = {"type": "bitmap", "array": texels, "raw": True, "filter_type": "nearest"}
    return MitsubaMaterial("tiles", {"type": "diffuse", "reflectance": bitmap}, {"type": "test"})


def coloured() -> Material:
    value = {"type": "rgb", "value": [0.7, 0.4, 0.2]}
    return MitsubaMaterial("red", {"type": "diffuse", "reflectance": value}, {"type": "test"})


@dataclass(frozen=True)
class Case:
    """An effect, scenes in which it does nothing and something, and the lists with and without."""

    idle: Callable[[], Scene]
    busy: Callable[[], Scene]
    on: tuple[str, ...]
    off: tuple[str, ...]
    idle_material: Callable[[], Material] = grey
    busy_material: Callable[[], Material] = grey


def _light(name: str) -> Case:
    return Case(
        lambda: hall(dark=name), hall, LIGHTS, tuple(light for light in LIGHTS if light != name)
    )


def _own(name: str, off: str = "material: plain") -> Case:
    return Case(
        hall, hall, ("environment", name), ("environment", off),
        lambda: Offset(strength=0.0), Offset,
    )  # fmt: skip


CASES = {
    "environment": _light("environment"),
    "area-lights": _light("area-lights"),
    "point-lights": _light("point-lights"),
    "indirect": Case(
        lambda: hall(apart=True), hall, (*LIGHTS, "indirect: 4"), LIGHTS
    ),
    "depth-of-field": Case(
        lambda: without_lens(hall()), lambda: without_lens(hall(), 1.5),
        ("environment", "depth-of-field"), ("environment",),
    ),
    "colour": Case(
        lambda: hall(grey=True), hall, LIGHTS, (*LIGHTS, "colour: luminance"), grey, coloured
    ),
    "texture": Case(
        hall, hall, ("environment", "texture"), ("environment", "material: plain"),
        lambda: tiles(0.0), lambda: tiles(0.4),
    ),
    "parallax": _own("parallax"),
    "prefiltering": _own("prefiltering"),
    "multiple-scattering": _own("multiple-scattering"),
    "media": _own("media"),
}  # fmt: skip


def images(scene: Scene, material: Material, case: Case) -> list:
    """With the effect and without it, of different seeds; and the pixels of all surfaces."""
    method = registry.make("cosine")
    method.bind(material)
    return [
        prepare(replace(scene, effects=effects), material, method, SIDE).render(SPP, seed)
        for seed, effects in enumerate((case.on, case.off))
    ]


def p_value(done: list, channel: int | None = None) -> float:
    """That the two images have one mean, by blocks of pixels and over all of them."""
    # Rounding, and edges that a ray may or may not pass, do not average out.
    rounding = (2.0**-14 * done[0].mean) ** 2
    means = [d.mean for d in done]
    variances = [done[0].variance / SPP, done[1].variance / SPP + rounding]
    return float(agreement(means, variances, np.ones_like(done[0].mean, bool), 4)[0].p_value)


@pytest.mark.parametrize("name", CASES)
def test_an_unneeded_effect_changes_no_pixel(name):
    case = CASES[name]
    assert p_value(images(case.idle(), case.idle_material(), case)) > ALPHA


@pytest.mark.parametrize("name", sorted(set(CASES) - {"colour"}))
def test_a_needed_effect_changes_the_image(name):
    """So that the test above could fail."""
    case = CASES[name]
    assert p_value(images(case.busy(), case.busy_material(), case)) < ALPHA


def test_colour_changes_colours_and_keeps_the_luminance_of_one_bounce():
    """In grey light the luminance is the same; in colour the image is not."""
    case = CASES["colour"]
    lit = images(hall(grey=True), coloured(), replace(case))
    on, off = (d.rgb for d in lit)
    assert p_value(lit) > ALPHA
    assert np.ptp(off, axis=-1).max() < 1e-5 < 0.05 < np.ptp(on, axis=-1).max()


@pytest.mark.parametrize("bounces", [(), ("indirect: 3",)])
def test_emitter_sampling_changes_noise_alone(bounces):
    """Nothing of the mean, and of the noise a good part, where lamps are small."""
    scene, material = hall(), grey()
    method = registry.make("cosine")
    method.bind(material)
    effects = ("environment", "area-lights", *bounces)
    off, on = (
        prepare(replace(scene, effects=(*effects, *more)), material, method, SIDE).render(SPP, s)
        for s, more in enumerate(((), ("emitter-sampling",)))
    )
    assert p_value([off, on]) > ALPHA
    assert on.variance.mean() < 0.5 * off.variance.mean()


def test_plain_textures_are_the_mean():
    """And conditions keep their columns, so that a fitted method goes on working."""
    whole = tiles(0.4)
    less = whole.with_effects(frozenset())
    assert whole.effects == {"texture"} and less.effects == frozenset()
    assert whole.with_effects(frozenset({"texture"})) is whole
    assert less.n_condition == whole.n_condition and less is whole.with_effects(frozenset())
    condition = less.conditions(100, torch.Generator().manual_seed(0))
    wo = torch.zeros(100, 2)
    assert less.eval(condition, wo) * np.pi == pytest.approx(np.full((100, 3), 0.7), abs=1e-5)
    assert condition[:, 2].std() < 1e-6
    # The whole one still has its tiles.
    f = whole.eval(whole.conditions(100, torch.Generator().manual_seed(0)), wo) * np.pi
    assert f.min() == pytest.approx(0.5, abs=1e-5) and f.max() == pytest.approx(0.9, abs=1e-5)
    assert less.identity() != whole.identity()
