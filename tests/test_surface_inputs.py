"""What a BSDF reads of a point is carried by the condition, or refused; and every scene asks."""

from __future__ import annotations

import textwrap

import numpy as np
import pytest
import torch

from harness.core import registry
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError, Unsupported
from harness.materials import registry as materials
from harness.scenes import registry as scenes
from harness.scenes.base import Camera, Scene, Sphere

RNG = np.random.default_rng(3)
HEIGHT = RNG.random((12, 12, 1)).astype(np.float32)


@pytest.fixture(scope="module")
def mi():
    """Mitsuba with its variant."""
    from harness.mitsuba_runtime.variant import use

    return use("cpu")


def made(bsdf):
    """A material of a Mitsuba dictionary, which may hold arrays of texels."""
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    return MitsubaMaterial("m", bsdf, {"type": "test"})


def bump(inner=None, scale=0.2):
    """Of random heights, around a rough conductor."""
    height = {"type": "bitmap", "array": HEIGHT, "raw": True}
    inner = inner or {"type": "roughconductor", "alpha": 0.1}
    return {"type": "bumpmap", "arbitrary": height, "scale": scale, "inner": inner}


def native(material):
    """The material's own sampler as a method."""
    method = registry.make("native")
    method.bind(material)
    return method


def ball(scale=(3.0, 2.0)):
    """A sphere in constant light."""
    camera = Camera((0.0, 0.5, 4.0), (0.0, 0.0, 0.0), fov=32.0)
    return Scene("ball", ("environment",), (Sphere(uv_scale=scale, rows=32),), 1.0, camera)


def test_a_bump_map_is_fitted_to_what_is_rendered(mi):
    """The harness's renders with the BSDF's own sampler have the variance of Mitsuba's."""
    from harness.rendering.prepared import prepare, prepare_native

    material = made(bump())
    own = prepare(ball(), material, native(material), 24, "bsdf")
    theirs = prepare_native(ball(), material, 24, "bsdf")
    a, b = (ready.render(256, 1) for ready in (own, theirs))
    assert a.error(own.mask) == pytest.approx(b.error(own.mask), rel=0.2)
    assert a.mean[own.mask].mean() == pytest.approx(b.mean[own.mask].mean(), rel=0.01)


def test_features_of_a_bump_map_are_tilted_normals(mi):
    """Against finite differences of the height: n ~ (-h_u / |dp_du|, -h_v / |dp_dv|, 1)."""
    material = made(bump())
    assert (material.n_address, material.n_features) == (6, 2)
    c = material.conditions(400, torch.Generator().manual_seed(1))
    uv, lengths = c[:, :2], c[:, (2, 5)]
    assert lengths.min() < 0.4 and lengths.max() > 2.5
    assert (c[:, (3, 4)] == 0).all()
    height = made({"type": "diffuse", "reflectance": bump()["arbitrary"]})
    step = 1e-3
    slope = []
    for axis in torch.eye(2):
        ends = [height.places(uv + s * step * axis)[:, 2] for s in (1, -1)]
        slope.append(0.2 * (ends[0] - ends[1]) / (2 * step))
    tilt = -torch.stack(slope, 1) / lengths
    expected = tilt / (1 + tilt.square().sum(1, keepdim=True)).sqrt()
    # Differences across the edge of a texel are of two slopes.
    apart = (c[:, 6:8] - expected).abs().amax(1)
    assert (apart < 0.02).double().mean() > 0.9


def test_the_lengths_are_read(mi):
    """A condition of longer derivatives has a flatter bump: the flat BSDF in the limit."""
    material, flat = made(bump()), made({"type": "roughconductor", "alpha": 0.1})
    c = material.conditions(300, torch.Generator().manual_seed(2))
    wo = square_to_disk(torch.rand(300, 2))
    far = c.clone()
    far[:, 2] = far[:, 5] = 1e4
    near = material.eval(c, wo)
    bare = flat.eval(c[:, -2:], wo)
    assert torch.allclose(material.eval(far, wo), bare, rtol=0.05, atol=1e-4)
    assert ((near - bare).abs() > 0.2 * bare).any(1).double().mean() > 0.5


@pytest.mark.parametrize(
    ("bsdf", "said"),
    [
        (
            {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
            "reflectance is an attribute of a mesh",
        ),
        (
            {"type": "diffuse", "reflectance": {"type": "volume", "volume": {
                "type": "gridvolume", "grid": "noise"}}},
            "reads the position of the point in space",
        ),
        (bump({"type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.4}), "lies in space"),
        ({"type": "mask", "opacity": 0.5, "inner": {"type": "diffuse"}}, "opacity is below one"),
        ({"type": "hair"}, "is of a fibre"),
        ({"type": "null"}, "light passes straight through"),
        ({"type": "roughdielectric"}, "transmits light"),
    ],
)  # fmt: skip
def test_refusals(mi, bsdf, said):
    """With the true reason, in one line."""
    volume = bsdf.get("reflectance", {})
    if isinstance(volume, dict) and volume.get("type") == "volume":
        grid = mi.VolumeGrid(RNG.random((4, 4, 4, 1)).astype(np.float32))
        volume["volume"] = {"type": "gridvolume", "grid": grid}
    with pytest.raises(InputError, match=said) as refused:
        made(bsdf)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("level", "said"), [(0.0, "nothing"), (1e-30, "next to nothing")])
def test_black_materials(mi, level, said):
    """Cannot be under test; around what is, they may be black, as lamps are."""
    bsdf = {"type": "diffuse", "reflectance": [level] * 3}
    spec = {"name": "m", "type": "mitsuba", "bsdf": bsdf}
    assert materials.make(spec).name == "m"
    with pytest.raises(InputError, match=f"reflects {said}"):
        materials.make_tested(spec)
    narrow = {"type": "roughconductor", "alpha": 0.001}
    assert materials.make_tested(spec | {"bsdf": narrow}).n_features == 0


@pytest.mark.parametrize("scale", [1, 63, 64, 128])
def test_a_pattern_of_any_frequency_has_its_feature(mi, scale):
    """Also one that repeats a whole number of times over every regular grid."""
    board = {"type": "checkerboard", "color0": 0.02, "color1": 0.6,
             "to_uv": mi.ScalarTransform4f().scale(scale)}  # fmt: skip
    assert made({"type": "roughconductor", "alpha": board}).n_features == 1


def test_a_small_mark_has_its_feature(mi):
    """One texel of a million; in colour one feature for each channel that differs."""
    texels = np.full((1024, 1024, 3), 0.5, np.float32)
    assert made({"type": "diffuse", "reflectance": {"type": "bitmap", "array": texels,
                                                    "raw": True}}).n_features == 0  # fmt: skip
    texels[700, 300] = (0.9, 0.9, 0.1)
    marked = made({"type": "diffuse", "reflectance": {"type": "bitmap", "array": texels,
                                                      "raw": True}})  # fmt: skip
    assert marked.n_features == 2


# --- asked in every scene --------------------------------------------------------------

PLUGINS = """
    import drjit as dr
    import mitsuba as mi


    class Own(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.level = props.get("level", 0.5)
            self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def value(self, si):
            return self.level

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = dr.zeros(mi.BSDFSample3f, dr.width(si.wi))
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
            bs.eta, bs.sampled_type = 1.0, mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            return bs, mi.Color3f(self.value(si)) & (active & (si.wi.z > 0))

        def eval(self, ctx, si, wo, active=True):
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return mi.Color3f(dr.select(lit, self.value(si) * wo.z * dr.inv_pi, 0))

        def pdf(self, ctx, si, wo, active=True):
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, wo.z * dr.inv_pi, 0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def traverse(self, callback):
            pass


    class FarOnly(Own):
        # Differs in a small place, which random points miss.
        def value(self, si):
            near = dr.norm(si.p - mi.Point3f(0, 0, 1)) < 0.35
            return dr.select(near & (dr.norm(si.p) > 0.99), 0.9, 0.5)


    class OfShape(Own):
        def value(self, si):
            there = (dr.reinterpret_array(mi.UInt32, si.shape) != 0)
            return dr.select(there, 0.9, 0.2)


    class OfMesh(Own):
        def value(self, si):
            return mi.luminance(si.shape.eval_attribute_3("vertex_color", si)) + 0.1


    class Height(Own):
        def value(self, si):
            return 0.5 + 0.4 * dr.sin(si.p.y)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With plugins of a user's own."""
    folder = tmp_path_factory.mktemp("plugins")
    (folder / "own.py").write_text(textwrap.dedent(PLUGINS))
    return folder


def own(name, folder, **more):
    """A material of one of them."""
    spec = {"name": "mine", "type": "mitsuba", "bsdf": {"type": f"own.py:{name}", **more}}
    return materials.make(spec, folder)


def test_a_plugin_of_ones_own(mi, folder):
    """Is loaded by its file, has its parameters, renders, and counts by its source."""
    from harness.rendering.prepared import prepare

    material = own("Own", folder, level=0.7)
    ready = prepare(ball(), material, native(material), 16)
    # Some samples graze the mesh and are lost, with Mitsuba's own spheres, too.
    assert np.median(ready.render(8, 0).mean[ready.mask]) == pytest.approx(0.7, abs=1e-4)
    before = material.identity()
    file = folder / "own.py"
    file.write_text(file.read_text() + "\n# a comment\n")
    assert own("Own", folder, level=0.7).identity() == before
    file.write_text(file.read_text().replace("0.9", "0.8"))
    assert own("Own", folder, level=0.7).identity() == before, "that was another class's"
    file.write_text(file.read_text().replace('"level", 0.5', '"level", 0.4'))
    assert own("Own", folder, level=0.7).identity() != before
    file.write_text(textwrap.dedent(PLUGINS))
    for name, said in (("Ow", "did you mean 'Own'"), ("dr", "no class 'dr'")):
        with pytest.raises(InputError, match=said):
            own(name, folder)
    with pytest.raises(InputError, match=r"no such file.*expected file.py:Class"):
        materials.make({"name": "m", "type": "mitsuba", "bsdf": {"type": "none.py:Own"}}, folder)


def test_position_is_refused_at_once(mi, folder):
    """Where it shows everywhere."""
    with pytest.raises(InputError, match="reads the position"):
        own("Height", folder)


@pytest.mark.parametrize("name", ["FarOnly", "OfShape"])
def test_a_scene_is_asked(mi, folder, name):
    """What no random point shows is found at true hits, and the trial is refused."""
    from harness.rendering.prepared import prepare

    material = own(name, folder)
    with pytest.raises(Unsupported, match=r"at \d+ of \d+ points of this scene"):
        prepare(ball(), material, native(material), 16)


def test_a_scene_that_agrees_is_rendered(mi):
    """Rounding is no difference: a narrow lobe, textures, a bump map, both sides."""
    from harness.rendering.prepared import prepare

    narrow = {"type": "roughconductor", "alpha": 0.002}
    noise = {"type": "bitmap", "array": RNG.random((64, 64, 3)).astype(np.float32), "raw": True}
    for bsdf in (narrow, {"type": "diffuse", "reflectance": noise}, bump(narrow),
                 {"type": "twosided", "inner": narrow},
                 {"type": "principled", "roughness": 0.05, "base_color": noise}):  # fmt: skip
        material = made(bsdf)
        ready = prepare(ball(), material, native(material), 16)
        assert ready.mask.any()


def test_both_sides(mi, tmp_path):
    """A surface seen from behind: as Mitsuba's own, for one that reflects from there and not."""
    from harness.rendering.prepared import prepare, prepare_native

    (tmp_path / "back.xml").write_text(
        """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0,0,-4" target="0,0,0" up="0,1,0"/></transform>
        </sensor><emitter type="constant"/><bsdf type="diffuse" id="m"/>
        <shape type="rectangle"><ref id="m"/></shape></scene>"""
    )
    scene = scenes.make({"file": "back.xml", "replace_bsdf": "m"}, tmp_path)
    inner = {"type": "roughconductor", "alpha": 0.3}
    both = made({"type": "twosided", "inner": inner})
    assert both.both_sides
    own_, theirs = (
        ready.render(64, 2).mean[8:16, 8:24]
        for ready in (prepare(scene, both, native(both), 32), prepare_native(scene, both, 32))
    )
    assert own_.mean() > 0.5 and own_.mean() == pytest.approx(theirs.mean(), rel=0.02)
    method = registry.make("cosine")
    method.bind(both)
    assert prepare(scene, both, method, 32).mask.sum() > 100
    front = made(inner)
    assert not front.both_sides
    ready = prepare(scene, front, native(front), 32)
    assert (ready.render(8, 2).mean[8:16, 8:24] == 0).all()
    other = made({"type": "twosided", "a": inner, "b": {"type": "diffuse"}})
    with pytest.raises(Unsupported, match="the side it is seen from"):
        prepare(scene, other, native(other), 32)


def test_a_torch_method_in_a_symbolic_render_says_so(mi):
    """As a plugin in a user's own script; in evaluated mode it works."""
    from harness.rendering.passes import evaluated_mode
    from harness.rendering.plugin import SampledBSDF

    material = made({"type": "roughconductor", "alpha": 0.3})
    method = registry.make("cosine")
    method.bind(material)
    bsdf = SampledBSDF(material, method)
    bsdf.in_columns = False
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"},
         "ball": {"type": "sphere", "bsdf": bsdf},
         "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8},
                    "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])}}
    )  # fmt: skip
    with pytest.raises(RuntimeError) as failed:
        mi.render(scene, spp=2)
    causes, error = [], failed.value
    while error is not None:
        causes.append(str(error))
        error = error.__cause__ or error.__context__
    assert any("runs in PyTorch" in text and "evaluated_mode" in text for text in causes)
    with evaluated_mode():
        image = np.array(mi.render(scene, spp=16))
    assert np.isfinite(image).all() and image[4, 4].mean() > 0.3


def test_values_are_ordinary_tensors(mi):
    """So that a method's own fit can take gradients through a loss with them."""
    material = made({"type": "roughconductor", "alpha": 0.3})
    condition = material.conditions(64, torch.Generator().manual_seed(0))
    wo = square_to_disk(torch.rand(64, 2))
    scale = torch.ones((), requires_grad=True)
    loss = (scale * material.eval(condition, wo)).sum()
    loss = loss + (scale * material.target(condition, wo)).sum()
    (loss * loss).backward()
    assert scale.grad is not None and scale.grad > 0
    assert not material.target_grid(condition, wo[None]).is_inference()
