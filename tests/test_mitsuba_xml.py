"""A user's XML file is read as Mitsuba reads it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from harness.core.protocol.errors import InputError
from harness.materials import registry as materials
from harness.mitsuba_runtime import mitsuba_xml
from harness.scenes import registry as scenes
from harness.scenes.named_files import named_files
from harness.suite.load import load

ROOM = """<scene version="3.0.0">
  <default name="res" value="32"/>
  <default name="kind" value="0.2"/>
  <path value="spectra"/>
  <include filename="things.xml"/>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <sampler type="multijitter"><integer name="sample_count" value="5"/></sampler>
    <film type="hdrfilm">
      <integer name="width" value="$res"/> <integer name="height" value="$res"/>
      <string name="pixel_format" value="rgba"/>
    </film>
  </sensor>
  <shape type="sphere"><ref id="metal"/></shape>
</scene>"""
THINGS = """<scene version="3.0.0">
  <bsdf type="roughconductor" id="metal">
    <float name="alpha" value="$kind"/>
    <spectrum name="eta" filename="eta.spd"/>
  </bsdf>
  <emitter type="constant"><spectrum name="radiance" filename="light.spd"/></emitter>
</scene>"""
SPEC = {"file": "room.xml", "replace_bsdf": "metal"}
DIFFUSE = {"name": "d", "type": "mitsuba", "bsdf": {"type": "diffuse", "reflectance": 0.5}}


@pytest.fixture
def folder(tmp_path):
    """A scene in two XML files with a spectrum beside it and one in a folder of its ``<path>``."""
    (tmp_path / "spectra").mkdir()
    (tmp_path / "room.xml").write_text(ROOM)
    (tmp_path / "things.xml").write_text(THINGS)
    (tmp_path / "light.spd").write_text("400 2\n700 2\n")
    (tmp_path / "spectra" / "eta.spd").write_text("400 0.2\n500 0.3\n600 2\n700 3\n")
    return tmp_path


def identity(folder, **more):
    """Of the scene, with more in its specification."""
    return scenes.identity(SPEC | more, folder)["xml"]


def test_everything_that_is_read_is_listed(folder):
    """Directly, by an include, through a path, by a spectrum; with the suite's own parameters."""
    names = ["room.xml", "things.xml", "spectra/eta.spd", "light.spd"]
    found = named_files(SPEC, folder)
    assert found[0] == (folder / "room.xml").resolve()
    assert set(found) == {(folder / name).resolve() for name in names}
    material = {"name": "m", "type": "mitsuba", "file": "room.xml"}
    assert set(named_files(material, folder)) == set(found)
    assert named_files("suede", folder) == []
    (folder / "suede").write_text("by chance")
    assert named_files("suede", folder) == []


def test_what_is_listed_decides_the_identity(folder):
    """Each of the files by content, and the parameters; but no comment and no folder."""
    before = identity(folder)
    for file in named_files(SPEC, folder):
        old = file.read_bytes()
        edited = old.replace(b"2", b"3").replace(b"0.0", b"0.1") if file.suffix == ".spd" else (
            old.replace(b'"40"', b'"41"').replace(b'"constant"', b'"constant" id="sky"')
        )  # fmt: skip
        assert edited != old
        file.write_bytes(edited)
        assert identity(folder) != before, file
        file.write_bytes(old)
    assert identity(folder) == before
    assert identity(folder, parameters={"res": 64}) != before
    assert identity(folder, parameters={"kind": 0.3}) != before
    (folder / "room.xml").write_text(ROOM.replace("<path", "<!-- where spectra are -->  <path"))
    assert identity(folder) == before
    moved = folder / "moved"
    moved.mkdir()
    for name in ("room.xml", "things.xml", "light.spd", "spectra"):
        (folder / name).rename(moved / name)
    assert identity(moved) == before


def test_exact_numbers_decide_the_identity(tmp_path):
    """A change in the tenth digit of a transform or a colour is a change."""
    text = """<scene version="3.0.0"><bsdf type="diffuse">
      <texture type="checkerboard" name="reflectance">
        <transform name="to_uv"><scale value="8.000000001"/></transform>
        <rgb name="color0" value="0.1234567891 0.2 0.3"/></texture></bsdf></scene>"""
    found = set()
    for old, new in (("", ""), ("8.000000001", "8.000000002"), ("7891", "7892")):
        (tmp_path / "m.xml").write_text(text.replace(old, new))
        spec = {"name": "m", "type": "mitsuba", "file": "m.xml"}
        found.add(materials.identity(spec, tmp_path)["xml"])
    assert len(found) == 3


def test_a_bsdf_with_spectra_by_file(folder):
    """As Mitsuba's own loader reads the whole file."""
    import mitsuba as mi

    spec = {"name": "m", "type": "mitsuba", "file": "room.xml", "parameters": {"kind": 0.35}}
    material = materials.make(spec, folder)
    mi.file_resolver().prepend(str(folder))
    whole = mi.load_file(str(folder / "room.xml"), kind="0.35")
    theirs = mi.traverse(whole.shapes()[0].bsdf())
    for key, value in mi.traverse(material.bsdf).items():
        assert np.array(value) == pytest.approx(np.array(theirs[key])), key


def test_the_scene_is_rendered(folder):
    """Parameters, an include, a sampler of dependent samples: the film is the harness's."""
    from harness.core import registry
    from harness.rendering.prepared import prepare

    material = materials.make(DIFFUSE)
    method = registry.make("cosine")
    method.bind(material)
    ready = prepare(scenes.make(SPEC, folder), material, method, 16)
    done = ready.render(7, 0)
    assert done.mean.shape == (16, 16) and ready.mask.sum() > 20
    # A spectrum that is two everywhere, seen in a white furnace of reflectance one half.
    assert done.mean[ready.mask].mean() == pytest.approx(1.0, rel=0.03)
    sensor = ready.scene.sensors()[0]
    assert "Independent" in sensor.sampler().class_name()


def test_an_old_version(tmp_path):
    """Names of version 0.6 are today's: its lens is found, and left out where not called for."""
    from harness.effects.offer import recipe_of
    from harness.rendering.build import integrator
    from harness.rendering.build_xml import build_xml

    (tmp_path / "old.xml").write_text(
        """<scene version="0.6.0"><integrator type="path"><integer name="maxDepth" value="4"/>
        </integrator><sensor type="thinlens"><float name="fov" value="40"/>
        <float name="apertureRadius" value="0.2"/><float name="focusDistance" value="3"/>
        <transform name="toWorld"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        </sensor><emitter type="constant"/><bsdf type="diffuse" id="metal"/>
        <shape type="sphere"><ref id="metal"/></shape></scene>"""
    )
    for effects, sensor in ((["environment"], "Perspective"), (
        ["environment", "depth-of-field"], "ThinLens")):  # fmt: skip
        scene = scenes.make(
            {"file": "old.xml", "replace_bsdf": "metal", "effects": effects}, tmp_path
        )
        assert scene.camera_has_lens
        bsdf = materials.make(DIFFUSE).bsdf
        built = build_xml(scene, {"metal": bsdf}, 24, recipe_of(scene))
        assert sensor in built.sensors()[0].class_name()
        # Without a film of its own it has Mitsuba's default one, of 4 by 3.
        assert list(built.sensors()[0].film().size()) == [24, 18]
        image = integrator(recipe_of(scene)).render(built, built.sensors()[0], seed=0, spp=4)
        assert np.isfinite(np.array(image)).all()


def test_a_part_of_the_film(tmp_path):
    """A film that is cropped shows the same part of the world, ``resolution`` pixels across."""
    from harness.effects.offer import recipe_of
    from harness.rendering import passes
    from harness.rendering.build import integrator
    from harness.rendering.build_xml import build_xml

    crop = """<film type="hdrfilm"><integer name="width" value="80"/>
      <integer name="height" value="40"/><integer name="crop_offset_x" value="40"/>
      <integer name="crop_offset_y" value="10"/><integer name="crop_width" value="20"/>
      <integer name="crop_height" value="10"/></film>"""
    (tmp_path / "part.xml").write_text(
        f"""<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        {crop}</sensor><emitter type="constant"/><bsdf type="diffuse" id="m"/>
        <shape type="sphere"><float name="radius" value="0.5"/><ref id="m"/></shape></scene>"""
    )
    scene = scenes.make({"file": "part.xml", "replace_bsdf": "m"}, tmp_path)
    recipe, bsdf = recipe_of(scene), materials.make(DIFFUSE).bsdf
    built = build_xml(scene, {"m": bsdf}, 40, recipe)
    done = passes.render(built, integrator(recipe), 16, 0)
    assert done.mean.shape == (20, 40) == passes.coverage(built, bsdf).shape
    # The sphere's middle is at the part's left edge, its rim (in pixels of the whole film
    # 80 tan(asin(1/8)) / (2 tan 20) = 13.85 of them) inside of the part's 20.
    lit = done.mean[10] > 0
    edge = 2 * 80 * math.tan(math.asin(0.5 / 4)) / (2 * math.tan(math.radians(20)))
    assert lit[: int(edge) - 1].all() and not lit[int(edge) + 2 :].any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"parameters": {"rse": 3}}, "it has no '$rse'; did you mean 'res'"),
        ({"parameters": [3]}, "parameters: expected a mapping"),
        ({"parameters": {"res": [3]}}, "res: expected a number or a text"),
        ({"replace_bsdf": "metall"}, "did you mean 'metal'"),
    ],
)
def test_refusals(folder, change, said):
    """One line each, with the nearest name."""
    with pytest.raises(InputError) as refused:
        scenes.make(SPEC | change, folder)
    assert said in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('value="$kind"', 'value="$kin"', "undefined parameter: $kin"),
        ("light.spd", "night.spd", "night.spd"),
        ('"$res"', '"many"', "many"),
        ('<ref id="metal"/>', '<ref id="mettle"/>', 'unresolved reference to "mettle"'),
        ('filename="things.xml"', 'filename="room.xml"', "include"),
        ('"perspective"', '"radiancemeter"', "expected a camera"),
    ],
)
def test_files_that_mitsuba_refuses(folder, old, new, said):
    """When they are read, not in the first render; without places in Mitsuba's source."""
    for name in ("room.xml", "things.xml"):
        file = folder / name
        file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError) as refused:
        scenes.make(SPEC, folder)
    assert said in str(refused.value) and ".cpp" not in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_texture_that_is_not_there(tmp_path):
    """Is refused by name, with what lies beside it."""
    (tmp_path / "wood.png").write_bytes(b"")
    (tmp_path / "m.xml").write_text(
        """<scene version="3.0.0"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="wod.png"/></texture></bsdf></scene>"""
    )
    with pytest.raises(InputError, match=r"no such file: wod.png; did you mean 'wood.png'"):
        materials.validate({"name": "m", "type": "mitsuba", "file": "m.xml"}, tmp_path)


def test_a_suite(folder):
    """A scene by its file alone, and parameters for all files that have them."""
    suite = folder / "suite.yaml"
    text = """
name: mine
materials: [{name: m, type: mitsuba, file: room.xml}, suede]
scenes: [{file: room.xml, replace_bsdf: metal, parameters: {res: 8}}]
methods: [cosine]
measures: [pdf]
parameters: {kind: 0.4, res: 16}
"""
    suite.write_text(text)
    found = load(suite).suite
    assert found.scenes[0].name == "room"
    assert found.scenes[0].rest()["parameters"] == {"kind": 0.4, "res": 8}
    assert found.materials[0].rest()["parameters"] == {"kind": 0.4, "res": 16}
    assert "parameters" not in found.materials[1].rest()
    suite.write_text(text.replace("kind: 0.4", "kid: 0.4"))
    with pytest.raises(InputError, match=r"no XML file of this suite has '\$kid'"):
        load(suite)


def test_the_search_path_is_as_before(folder):
    """Reading a file leaves nothing behind in Mitsuba."""
    import mitsuba as mi

    before = str(mi.file_resolver())
    mitsuba_xml.read(folder / "room.xml", "test")
    assert str(mi.file_resolver()) == before
