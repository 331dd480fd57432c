"""Effects: how they are written, what they build, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.core.protocol.errors import InputError
from harness.effects.base import Offer, Recipe
from harness.effects.offer import recipe_of
from harness.effects.registry import EFFECTS, checked, is_auto, parse, recipe, refusals
from harness.scenes import registry
from harness.scenes.base import AreaLamp, PointLamp

ALL = Offer(
    "hall",
    frozenset({"environment", "area-lights", "point-lights"}),
    lens=True,
    media=True,
    material=frozenset({"texture", "parallax", "prefiltering", "multiple-scattering", "media"}),
)
LAMPS = (AreaLamp((0, 3, 0), (0, 0, 0), (1, 1), (5, 4, 3)), PointLamp((0, 3, 0), (1, 1, 1)))


def test_every_effect_says_what_it_is():
    for name, effect in EFFECTS.items():
        assert effect.name == name and effect.about and effect.__doc__


def test_recipe_of_one_light_is_the_leanest():
    assert recipe(["environment"]) == Recipe(lights=frozenset({"environment"}))
    assert recipe(["environment"]).integrator == "direct"


@pytest.mark.parametrize(
    ("written", "changed"),
    [
        ("area-lights", {"lights": frozenset({"environment", "area-lights"})}),
        ("emitter-sampling", {"emitter_sampling": True}),
        ("indirect: 12", {"bounces": 12}),
        ("depth-of-field", {"lens": True}),
        ("colour: luminance", {"channels": 1}),
        ("colour: rgb", {}),
        ("parallax", {"material": frozenset({"parallax"})}),
        ("texture", {"material": frozenset({"texture"})}),
        ("material: plain", {"material": frozenset()}),
        ("material: whole", {}),
        ("media", {"material": frozenset({"media"}), "media": True}),
    ],
)
def test_each_effect_adds_one_thing(written, changed):
    alone = recipe(["environment"])
    assert recipe(["environment", written]) == replace(alone, **changed)


def test_integrators():
    assert recipe(["environment", "indirect: 2"]).integrator == "path"
    assert recipe(["environment", "media"]).integrator == "volpath"
    # A scene without media needs no integrator for them, whatever its material does inside.
    scene = registry.make("uniform-sphere")
    inside = replace(scene, effects=("environment", "media"))
    assert recipe_of(inside).integrator == "direct"


def test_effects_of_the_material():
    """None named: as it is. Any named: those alone."""
    own = frozenset({"texture", "parallax"})
    assert recipe(["environment"]).of(own) == own
    assert recipe(["environment", "texture"]).of(own) == {"texture"}
    assert recipe(["environment", "texture", "parallax"]).of(own) == own
    assert recipe(["environment", "material: plain"]).of(own) == frozenset()


def test_written_forms_of_yaml_and_of_a_scene_are_one():
    as_yaml = ["environment", {"indirect": 12}, {"colour": "luminance"}, "environment"]
    texts = checked(as_yaml, "x")
    assert texts == ("environment", "indirect: 12", "colour: luminance")
    assert checked(texts, "x") == texts
    assert [str(effect) for effect in parse(texts)] == list(texts)


@given(st.integers(2, 1000))
def test_bounces_survive_their_text(n):
    assert recipe(checked(["environment", {"indirect": n}], "x")).bounces == n


@pytest.mark.parametrize(
    ("given_", "tolerance"),
    [("auto", 0.01), (["auto"], 0.01), ({"auto": 0.05}, 0.05), (("auto: 0.05",), 0.05)],
)
def test_auto(given_, tolerance):
    texts = checked(given_, "x")
    assert texts == (f"auto: {tolerance:g}",) and is_auto(texts) and not is_auto(["environment"])
    with pytest.raises(InputError, match="has to be resolved"):
        parse(texts)


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        (["enviroment"], "unknown effect 'enviroment'; did you mean 'environment'?"),
        (["environment", "emitter_sampling"], "did you mean 'emitter-sampling'?"),
        (["environment", {"inderect": 3}], "did you mean 'indirect'?"),
        (["environment", "indirect"], "expected the most bounces, 2 or more"),
        (["environment", {"indirect": 1}], "expected the most bounces, 2 or more"),
        (["environment", {"indirect": True}], "expected the most bounces"),
        (["environment", {"colour": "mono"}], "expected rgb or luminance"),
        (["environment", {"texture": 3}], "takes no value"),
        (["environment", {"material": "bare"}], "expected whole or plain"),
        (["environment", {"indirect": 2}, {"indirect": 3}], "contradict each other"),
        (["environment", {"material": "plain"}, "texture"], "contradict each other"),
        (["indirect: 3"], "expected at least one light"),
        ([], "expected at least one light"),
        (["point-lights"], "'point-lights' does nothing without 'emitter-sampling'"),
        ("environment", "expected a list of names, or auto"),
        ({"environment": 1}, "expected a list of names, or auto"),
        (7, "expected a list of names"),
        (["environment", "auto"], "unknown effect 'auto'"),
        ({"auto": 2}, "a tolerance between 0 and 1"),
        ({"auto": "x"}, "a tolerance between 0 and 1"),
        (("auto: x",), "a tolerance between 0 and 1"),
    ],
)
def test_refused_as_written(given_, message):
    with pytest.raises(InputError) as refused:
        checked(given_, "scene 'x'")
    assert message in str(refused.value) and "\n" not in str(refused.value)
    assert str(refused.value).startswith("scene 'x': ")


def test_all_can_be_had_of_one_that_has_all():
    texts = checked(
        ["environment", "area-lights", "point-lights", "emitter-sampling", "indirect: 3",
         "depth-of-field", "media", "texture", "parallax", "prefiltering",
         "multiple-scattering"], "x",
    )  # fmt: skip
    assert refusals(texts, ALL) == []


@pytest.mark.parametrize(
    ("written", "lost", "reason"),
    [
        ("area-lights", {"lights": frozenset({"environment"})}, "its lights: environment"),
        ("environment", {"lights": frozenset()}, "its lights: none"),
        ("depth-of-field", {"lens": False}, "has no aperture"),
        ("media", {"media": False, "material": frozenset()}, "neither the scene 'hall' nor"),
        ("parallax", {"material": frozenset({"texture"})}, "(its effects: texture)"),
        ("texture", {"material": frozenset()}, "none of its own"),
    ],
)
def test_refused_where_it_cannot_be_had(written, lost, reason):
    assert refusals([written], ALL) == []
    found = refusals([written], replace(ALL, material_name="'paint'", **lost))
    assert len(found) == 1 and reason in found[0] and found[0].startswith(f"effect '{written}'")
    # Before a material is known, only the scene can lack anything.
    if "material" in lost:
        assert refusals([written], replace(ALL, **{**lost, "material": None})) == []


def test_a_scene_is_refused_for_what_it_has_not():
    with pytest.raises(InputError, match="'uniform-sphere' has no such light"):
        registry.make({"name": "uniform-sphere", "effects": ["area-lights"]})
    with pytest.raises(InputError, match="has no aperture"):
        registry.make({"name": "uniform-sphere", "effects": ["environment", "depth-of-field"]})


def test_one_scene_under_several_names():
    spec = {"name": "with-mis", "scene": "studio-sphere",
            "effects": ["environment", "emitter-sampling"]}  # fmt: skip
    scene = registry.make(spec)
    assert scene.name == "with-mis" and scene.effects == ("environment", "emitter-sampling")
    identity, plain = registry.identity(spec), registry.identity("studio-sphere")
    assert identity != plain
    assert {**identity, "effects": plain["effects"]} == plain
    with pytest.raises(InputError, match="did you mean 'studio-sphere'"):
        registry.make({"name": "x", "scene": "studio-spere"})


def test_lights_of_a_scene():
    scene = registry.make("uniform-sphere")
    assert replace(scene, lamps=LAMPS).lights == ALL.lights
    assert replace(scene, environment=None, lamps=LAMPS[:1]).lights == {"area-lights"}
