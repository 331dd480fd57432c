"""What a scene does not call for is not run: the counts say so."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import torch

from harness.core import registry
from harness.core.protocol import counting
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.scenes.base import Scene, XmlScene
from tests.effect_fakes import OWN, Offset, hall

mi = variant.use("cpu")

from harness.materials.mitsuba_bsdf import MitsubaMaterial  # noqa: E402
from harness.rendering.meter import Meter  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402

SIDE, SPP = 12, 8


def plain() -> Material:
    """One of Mitsuba's."""
    return MitsubaMaterial("rough", {"type": "roughconductor", "alpha": 0.4}, {"type": "test"})


def metered(scene: Scene | XmlScene, material: Material, method: str = "cosine") -> Meter:
    """One render by the method, counted."""
    made = registry.make(method)
    made.bind(material)
    meter = Meter()
    prepare(scene, material, made, SIDE, meter=meter).render(SPP, 3)
    return meter


def counts(scene: Scene | XmlScene, material: Material, method: str = "cosine") -> Counter:
    """Over all surfaces and lights."""
    return metered(scene, material, method).counts


@pytest.mark.parametrize("bounces", [(), ("indirect: 3",)])
@pytest.mark.parametrize("method", ["cosine", "native"])
def test_no_shadow_ray_and_no_pdf_query_without_emitter_sampling(bounces, method):
    lights = ("environment", "area-lights")
    off = counts(hall(*lights, *bounces), plain(), method)
    on = counts(hall(*lights, "emitter-sampling", *bounces), plain(), method)
    assert off["shadow-rays"] == off["pdf-queries"] == 0
    assert on["shadow-rays"] > 0.5 * on["bounces"]
    assert on["pdf-queries"] > 0.2 * on["bounces"]
    # Without it, whatever is evaluated is the direction that was sampled.
    assert off["evaluations"] <= off["samples"] < on["evaluations"]


def test_one_bounce_without_indirect():
    """Every camera ray is scattered once at most; with ``indirect: n`` n times at most."""
    one = counts(hall("environment"), plain())
    hits = one["bounces"]
    assert 0.5 * SIDE**2 * SPP < hits <= SIDE**2 * SPP
    two = counts(hall("environment", "indirect: 2"), plain())
    three = counts(hall("environment", "indirect: 3"), plain())
    assert hits < two["bounces"] < three["bounces"]
    assert two["bounces"] <= 2 * SIDE**2 * SPP and three["bounces"] <= 3 * SIDE**2 * SPP


def test_no_light_query_for_lights_that_are_not_built():
    """A light that is not called for is not in the scene: nobody can ask it."""
    method = registry.make("cosine")
    for lights in (["environment"], ["area-lights"], ["point-lights", "emitter-sampling"]):
        material = plain()
        method.bind(material)
        built = prepare(hall(*lights), material, method, SIDE).scene.emitters()
        assert len(built) == 1
        flag = {
            "environment": mi.EmitterFlags.Infinite,
            "area-lights": mi.EmitterFlags.Surface,
            "point-lights": mi.EmitterFlags.DeltaPosition,
        }[lights[0]]
        assert mi.has_flag(built[0].flags(), flag)


@pytest.mark.parametrize("effect", sorted(OWN))
def test_no_part_of_a_material_without_its_effect(effect):
    """Such as no offset network without ``parallax``."""
    material = Offset()
    meter = metered(hall("environment", effect), material)
    on = meter.counts
    assert on[effect] == meter.parts["eval"].rows > 0
    for other in OWN - {effect}:
        assert on[other] == 0
        assert counts(hall("environment", other), material)[effect] == 0
    assert counts(hall("environment", "material: plain"), material)[effect] == 0
    # Nothing said about the material leaves it whole.
    assert counts(hall("environment"), material)[effect] > 0


@pytest.mark.parametrize("material", [plain, Offset])
def test_one_channel_with_luminance(material):
    effects = ("environment", "area-lights", "emitter-sampling", "indirect: 2")
    colour = counts(hall(*effects), material())
    grey = counts(hall(*effects, "colour: luminance"), material())
    assert colour["values"] == 3 * colour["evaluations"] > 0
    assert grey["values"] == grey["evaluations"] > 0


def test_networks_are_counted_for_what_asks_them():
    """One evaluation a sample; with MIS one a pdf query too."""
    material = plain()
    method = registry.make("improved-baseline")
    budget = Budget(steps=2, conditions=8, directions=8, resolution=16, pool=16)
    method.fit(material, budget, torch.Generator().manual_seed(0))
    for effects in (("environment",), ("environment", "emitter-sampling")):
        meter = Meter()
        prepare(hall(*effects), material, method, SIDE, meter=meter).render(SPP, 3)
        assert meter.counts["network"] >= sum(meter.parts[p].rows for p in ("sample", "pdf")) > 0
        asked = meter.parts["sample"].calls + meter.parts["pdf"].calls
        assert asked == (1 if effects == ("environment",) else 2)


def test_counters_are_open_only_inside_their_block():
    inner, outer = Counter(), Counter()
    counting.add("x", 1)
    with counting.into(outer):
        counting.add("x", 2)
        with counting.into(inner):
            counting.add("x", 3)
        assert counting.wanted()
        counting.add("y", 4)
    counting.add("x", 5)
    assert not counting.wanted()
    assert inner == {"x": 3} and outer == {"x": 5, "y": 4}


def test_a_meter_does_not_change_the_image():
    material = plain()
    method = registry.make("cosine")
    method.bind(material)
    scene = hall("environment", "area-lights", "point-lights", "emitter-sampling", "indirect: 3")
    bare = prepare(scene, material, method, SIDE).render(SPP, 5)
    seen = prepare(scene, material, method, SIDE, meter=Meter()).render(SPP, 5)
    # Rounding decides whether a shadow ray that grazes an edge passes it: a few in a thousand.
    same = np.isclose(seen.rgb, bare.rgb, rtol=1e-4, atol=1e-5).all(-1)
    assert same.mean() > 0.97
    assert seen.rgb.mean() == pytest.approx(bare.rgb.mean(), rel=1e-3)


XML = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="thinlens">
    <float name="aperture_radius" value="0.1"/> <float name="focus_distance" value="4"/>
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0,0.5,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film>
  </sensor>
  <emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>
  <emitter type="point"><rgb name="intensity" value="3"/><point name="position" x="2" y="2" z="3"/></emitter>
  <medium type="homogeneous" id="fog"><rgb name="albedo" value="0.9"/></medium>
  <bsdf type="diffuse" id="ball"/>
  <bsdf type="twosided" id="wall"><bsdf type="plastic"/></bsdf>
  <bsdf type="diffuse" id="lamp"/>
  <shape type="sphere"><ref id="ball"/><float name="radius" value="0.7"/></shape>
  <shape type="rectangle"><ref id="wall"/>
    <transform name="to_world"><scale value="4"/><translate z="-1"/></transform></shape>
  <shape type="cube"><bsdf type="null"/><ref name="interior" id="fog"/>
    <transform name="to_world"><scale value="0.5"/><translate x="0.9" z="0.4"/></transform></shape>
  <shape type="rectangle"><ref id="lamp"/>
    <transform name="to_world"><rotate x="1" angle="90"/><translate y="2"/></transform>
    <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>
</scene>"""  # noqa: E501


def xml(folder, *effects: object, replace_bsdf: object = "ball") -> XmlScene:
    """The file, written, and what it is to be rendered with."""
    (folder / "room.xml").write_text(XML)
    spec = {"name": "room", "file": "room.xml", "replace_bsdf": replace_bsdf}
    return scenes.make(spec | ({"effects": list(effects)} if effects else {}), folder)


def test_effects_of_a_users_file(tmp_path):
    """Its lights by default; and only what is called for of them, its lens and its media."""
    usual = xml(tmp_path)
    assert set(usual.effects) == {"environment", "area-lights", "point-lights", "emitter-sampling"}
    method, material = registry.make("cosine"), plain()
    method.bind(material)
    found = prepare(usual, material, method, SIDE)
    assert len(found.scene.emitters()) == 3 and found.recipe.integrator == "direct"
    assert type(found.scene.sensors()[0]).__name__ != "ThinLensCamera"
    one = prepare(xml(tmp_path, "area-lights"), material, method, SIDE)
    assert len(one.scene.emitters()) == 1
    deep = xml(tmp_path, "environment", {"indirect": 3}, "media", "depth-of-field")
    assert prepare(deep, material, method, SIDE).recipe.integrator == "volpath"


@pytest.mark.parametrize("more", [(), ("media",)])
def test_counts_in_a_users_file(tmp_path, more):
    """All its surfaces obey, also those that keep their BSDF."""
    material = plain()
    effects = ("environment", "area-lights", {"indirect": 3}, *more)
    off = counts(xml(tmp_path, *effects), material)
    on = counts(xml(tmp_path, *effects, "emitter-sampling"), material)
    if not more:  # A medium samples lights by itself.
        assert off["shadow-rays"] == 0
    assert off["pdf-queries"] == 0
    assert on["pdf-queries"] > 0 and on["shadow-rays"] > off["shadow-rays"]


def test_several_bsdfs_are_replaced(tmp_path):
    """By the material under test, or by others."""
    material, method = plain(), registry.make("cosine")
    method.bind(material)
    both = prepare(xml(tmp_path, replace_bsdf=["ball", "wall"]), material, method, SIDE)
    on = [shape.bsdf() for shape in both.scene.shapes()]
    assert sum(bsdf is both.bsdf for bsdf in on) == 2
    spec = {"name": "red", "type": "mitsuba", "bsdf": {"type": "diffuse", "reflectance": 0.1}}
    mixed = prepare(
        xml(tmp_path, replace_bsdf={"ball": "tested", "wall": spec}), material, method, SIDE
    )
    on = [shape.bsdf() for shape in mixed.scene.shapes()]
    assert sum(bsdf is mixed.bsdf for bsdf in on) == 1
    assert any("0.1" in str(bsdf) for bsdf in on)
    assert mixed.mask.sum() < both.mask.sum()


def test_a_path_that_is_left_alone():
    """Of a few paths one goes on: a method and a material in torch are asked for one row."""
    material, method = Offset(), registry.make("cosine")
    method.bind(material)
    lights = ("environment", "point-lights", "emitter-sampling", "indirect: 12")
    prepared = prepare(hall(*lights), material, method, 3)
    for seed in range(12):
        assert np.isfinite(prepared.render(2, seed).rgb).all()


def test_no_offset_network_of_a_neural_material_without_parallax():
    """The untrained network will do: it is run or it is not."""
    from harness.materials.neural.architecture import Architecture
    from harness.materials.neural.material import NeuralMaterial
    from harness.materials.neural.network import NeuralMBTF

    torch.manual_seed(0)
    network = NeuralMBTF(Architecture(resolution=8, offset_resolution=8))
    material = NeuralMaterial("untrained", network, {"type": "test"})
    assert "parallax" in material.effects
    on = counts(hall("environment", "parallax"), material)
    off = counts(hall("environment", "material: plain"), material)
    assert on["parallax"] > 0 == off["parallax"]
    assert on["network"] == off["network"] + on["parallax"]
