"""What public Mitsuba scenes are made of: each renders as Mitsuba does, or is refused at once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from harness.core import registry
from harness.core.protocol.errors import InputError
from harness.materials import registry as materials
from harness.scenes import registry as scenes

AT = '<transform name="to_world"><lookat origin="{}" target="0,0,0" up="0,1,0"/></transform>'
CAMERA = f"""<sensor type="perspective"><float name="fov" value="40"/>{AT.format("0,0.5,4")}
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/></film>
  </sensor>"""
SKY = '<emitter type="constant"/>'
OBJECT = '<bsdf type="diffuse" id="m"/><shape type="sphere"><ref id="m"/></shape>'
SHAPE = '<bsdf type="diffuse" id="m"/><shape type="{}">{}<ref id="m"/></shape>'
TURNED = '<transform name="to_world"><scale value="0.6"/><rotate y="1" angle="30"/></transform>'
LYING = '<transform name="to_world"><translate z="-0.5"/><rotate y="1" angle="80"/></transform>'
LENS = '<float name="aperture_radius" value="0.1"/><float name="focus_distance" value="3"/>'
BESIDE = """<shape type="sphere"><point name="center" x="1.2" y="0.6" z="1"/>
  <float name="radius" value="0.3"/>{}</shape>"""
WALL = """<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-2"/>
  </transform>{}</shape>"""
PICTURE = '<texture type="bitmap" name="{}"><string name="filename" value="tex.png"/></texture>'


def lit(light: str) -> str:
    """The object in the light of an emitter."""
    return CAMERA + light + OBJECT


def shaped(kind: str, more: str = TURNED) -> str:
    """Another shape in a constant sky."""
    return CAMERA + SKY + SHAPE.format(kind, more)


def seen(old: str, new: str) -> str:
    """Another camera or film."""
    assert old in CAMERA
    return CAMERA.replace(old, new) + SKY + OBJECT


FEATURES = {
    "environment-map": lit(
        '<emitter type="envmap"><string name="filename" value="sky.exr"/>'
        '<transform name="to_world"><rotate y="1" angle="70"/></transform></emitter>'
    ),
    "sun-and-sky": lit('<emitter type="sunsky"><float name="turbidity" value="3"/></emitter>'),
    "area-light": lit(
        f'<shape type="rectangle">{AT.format("2,3,2")}<emitter type="area"/></shape>'
    ),
    "point-light": lit(
        '<emitter type="point"><point name="position" x="2" y="2" z="3"/></emitter>'
    ),
    "spot-light": lit(f'<emitter type="spot">{AT.format("2,2,3")}</emitter>'),
    "directional-light": lit(
        '<emitter type="directional"><vector name="direction" x="-1" y="-1" z="-1"/></emitter>'
    ),
    "projector": lit(
        f'<emitter type="projector">{PICTURE.format("irradiance")}'
        f'<float name="fov" value="30"/>{AT.format("0,1,4")}</emitter>'
    ),
    "cube": shaped("cube"),
    "cylinder": shaped("cylinder", LYING),  # along its axis only a rim of it is seen
    "disk": shaped("disk", ""),
    "rectangle": shaped("rectangle"),
    "mesh": shaped("obj", f'<string name="filename" value="quad.obj"/>{TURNED}'),
    "instances": CAMERA
    + SKY
    + '<bsdf type="diffuse" id="m"/><shape type="shapegroup" id="g"><shape type="sphere">'
    '<ref id="m"/></shape></shape><shape type="instance"><ref id="g"/><transform name="to_world">'
    '<scale value="0.5"/></transform></shape><shape type="instance"><ref id="g"/>'
    '<transform name="to_world"><scale value="0.3"/><translate x="0.9"/></transform></shape>',
    "bsdf-in-a-shape": CAMERA
    + SKY
    + '<shape type="sphere"><bsdf type="twosided" id="m"><bsdf type="diffuse"/></bsdf></shape>',
    "alias": CAMERA
    + SKY
    + '<bsdf type="diffuse" id="m"/><alias id="m" as="n"/><shape type="sphere"><ref id="n"/>'
    "</shape>",
    "orthographic": seen('"perspective"><float name="fov" value="40"/>', '"orthographic">'),
    "lens": seen('"perspective">', f'"thinlens">{LENS}'),
    "film-of-spectra": seen('"hdrfilm"', '"specfilm"'),
    "filter": seen("</film>", '<rfilter type="lanczos"/></film>'),
    "sampler": seen(
        "</sensor>",
        '<sampler type="stratified"><integer name="sample_count" value="16"/></sampler></sensor>',
    ),
    "two-cameras": lit(SKY) + CAMERA,
    "integrator": '<integrator type="volpathmis"/>' + lit(SKY),
    "glass-beside": lit(SKY) + BESIDE.format('<bsdf type="dielectric"/>'),
    "mask-beside": lit(SKY)
    + BESIDE.format('<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/>'
                    "</bsdf>"),
    "mesh-colours-beside": lit(SKY)
    + BESIDE.format('<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance">'
                    '<string name="name" value="vertex_color"/></texture></bsdf>'),
    "picture-beside": lit(SKY) + WALL.format(
        f'<bsdf type="diffuse">{PICTURE.format("reflectance")}</bsdf>'),
    "volume-beside": lit(SKY)
    + BESIDE.format('<bsdf type="null"/><medium type="homogeneous" name="interior"/>'),
    "colour": lit('<emitter type="constant"><rgb name="radiance" value="1, 0.5, 0.2"/></emitter>'),
    "black-body": lit(
        '<emitter type="constant"><spectrum name="radiance" value="400:0.5, 700:1.5"/></emitter>'
    ),
    "no-name-for-a-reference": lit(SKY).replace('<ref id="m"/>', '<ref name="bsdf" id="m"/>'),
}  # fmt: skip
REFUSED = {
    "no-light": (CAMERA + OBJECT, "has no <emitter>"),
    "no-camera": (SKY + OBJECT, "has no <sensor>"),
    "no-bsdf": (CAMERA + SKY + '<shape type="sphere"/>', "no BSDF of id 'm'"),
    "distant-sensor": (seen('"perspective">', '"distant">'), "expected a camera"),
    "broken-reference": (lit(SKY).replace('<ref id="m"/>', '<ref id="q"/>'), "unresolved"),
    "twice-the-same-id": (lit(SKY) + OBJECT, "m"),
    "unknown-element": (lit(SKY) + "<thing/>", "thing"),
    "colour-in-hex": (
        lit('<emitter type="constant"><rgb name="radiance" value="#ff8040"/></emitter>'),
        'could not parse RGB value "#ff8040"',
    ),
    "no-picture": (lit(SKY) + WALL.format(
        f'<bsdf type="diffuse">{PICTURE.format("reflectance")}</bsdf>'
    ).replace("tex.png", "text.png"), "did you mean 'tex.png'"),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """All scenes, and the files that they name."""
    from harness.mitsuba_runtime.variant import use

    mi, folder = use("cpu"), tmp_path_factory.mktemp("features")
    rng = np.random.default_rng(0)
    mi.Bitmap(rng.random((8, 16, 3)).astype(np.float32) + 0.1).write(str(folder / "sky.exr"))
    mi.Bitmap((rng.random((8, 8, 3)) * 255).astype(np.uint8)).write(str(folder / "tex.png"))
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    lines = [f"v {x} {y} 0\nvt {(x + 1) / 2} {(y + 1) / 2}" for x, y in corners]
    faces = "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
    (folder / "quad.obj").write_text("\n".join([*lines, "vn 0 0 1", faces]))
    for name, body in {**FEATURES, **{n: b for n, (b, _) in REFUSED.items()}}.items():
        (folder / f"{name}.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
    return folder


def spec(name: str) -> dict[str, str]:
    """As in a suite."""
    return {"file": f"{name}.xml", "replace_bsdf": "m"}


@pytest.mark.parametrize("name", FEATURES)
def test_is_read(folder, name):
    """And has an identity of its own."""
    scenes.make(spec(name), folder)
    scenes.identity(spec(name), folder)


@pytest.mark.parametrize("name", REFUSED)
def test_is_refused(folder, name):
    """In one line, before anything runs."""
    with pytest.raises(InputError) as refused:
        scenes.make(spec(name), folder)
    assert REFUSED[name][1] in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("name", FEATURES)
def test_is_rendered_as_by_mitsuba(folder, name):
    """The whole picture, of the cosine and of Mitsuba's own sampler, and not a black one."""
    from harness.rendering.prepared import prepare, prepare_native

    scene = scenes.make(spec(name), folder)
    material = materials.make(
        {"name": "m", "type": "mitsuba", "bsdf": {"type": "roughconductor", "alpha": 0.4}}
    )
    method = registry.make("cosine")
    method.bind(material)
    own = prepare(scene, material, method, 24)
    theirs = prepare_native(scene, material, 24, None)
    a, b = own.render(64, 1), theirs.render(64, 2)
    error = math.sqrt((a.variance.mean() + b.variance.mean()) / 64 / a.mean.size)
    assert own.mask.sum() > 50 and b.mean.mean() > 0
    assert a.mean.mean() == pytest.approx(b.mean.mean(), abs=5 * error + 1e-6)
