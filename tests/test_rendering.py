"""A method and its material as one Mitsuba BSDF, and renders with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core import registry
from harness.core.protocol.disk import cos_theta, inside_disk, square_to_disk
from harness.core.protocol.errors import InputError, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.ztest import agreement
from tests.materials import Tilted, normal_mapped
from tests.planted import Correct, Plaster

mi = variant.use("cpu")

import drjit as dr  # noqa: E402  a variant has to be set first

from harness.checks.mitsuba_chi2 import mitsuba_chi2  # noqa: E402
from harness.materials.mitsuba_bsdf import MitsubaMaterial  # noqa: E402
from harness.measures.images import checked  # noqa: E402
from harness.rendering import passes  # noqa: E402
from harness.rendering.plugin import SampledBSDF  # noqa: E402
from harness.rendering.prepared import prepare, prepare_native  # noqa: E402


def mitsuba(name: str, **bsdf: object) -> MitsubaMaterial:
    """One of Mitsuba's own."""
    return MitsubaMaterial(name, {"type": name, **bsdf}, {"type": "test", "name": name})


def white() -> MitsubaMaterial:
    """Lambertian, reflects everything."""
    return mitsuba("diffuse", reflectance={"type": "rgb", "value": 1.0})


def rough() -> MitsubaMaterial:
    """A broad highlight on a coloured ground."""
    return mitsuba(
        "principled", base_color={"type": "rgb", "value": [0.6, 0.4, 0.2]}, roughness=0.5
    )


class UniformDisk(Method):
    """The cosine sampler again, in torch and by the same formulas."""

    name = "uniform-disk"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = 2 * math.pi * u[:, 1]
        wo = u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(inside_disk(wo), 1 / math.pi, 0)


class SometimesNan(UniformDisk):
    """A nan once in a thousand samples: in the density or in the direction."""

    name = "sometimes-nan"

    def __init__(self, where: str):
        self.where = where

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        bad = u[:, 2] < 1e-3
        if self.where == "pdf":
            return DiskSample(wo, torch.where(bad, math.nan, pdf))
        return DiskSample(torch.where(bad[:, None], math.nan, wo), pdf)


class White(Material):
    """Lambertian, in torch; grey of any albedo."""

    name = "white"

    def __init__(self, albedo: float = 1.0):
        self.albedo = albedo

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        value = torch.where(inside_disk(wo), self.albedo / math.pi, 0)
        return value[:, None].expand(-1, 3)

    def identity(self) -> dict[str, object]:
        """See :meth:`Material.identity`."""
        return {"type": "test", "name": self.name}


def ready(name: str | Method, material: Material, **parameters: object) -> Method:
    """A method, fitted briefly."""
    method = registry.make(name, **parameters) if isinstance(name, str) else name
    budget = Budget(steps=20, conditions=32, directions=16, resolution=16, pool=64)
    method.fit(material, budget, torch.Generator().manual_seed(0))
    return method


def interactions(condition: Tensor, material: Material, below: Tensor | None = None):
    """Surface interactions of the conditions [N, C] of ``material``, uv as their address."""
    n = len(condition)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    wi = condition[:, -2:]
    side = torch.ones(n) if below is None else torch.where(below, -1.0, 1.0)
    si.wi = vector(wi, side * cos_theta(wi))
    uv = (
        condition[:, :2]
        if material.n_address or isinstance(material, Tilted)
        else torch.zeros(n, 2)
    )
    si.uv = mi.Point2f(*(mi.Float(c.numpy()) for c in uv.T.contiguous()))
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    return si


def vector(xy: Tensor, z: Tensor):
    """Mitsuba vectors."""
    x, y = (mi.Float(c.contiguous().numpy()) for c in xy.T)
    return mi.Vector3f(x, y, mi.Float(z.contiguous().numpy()))


def numpy(value) -> np.ndarray:
    """[N] or [N, 3] of a Dr.Jit number or vector."""
    array = np.asarray(value.numpy())
    return array.T if array.ndim == 2 else array


PAIRS = {
    "torch-torch": lambda: (Correct(), Plaster()),
    "torch-mitsuba": lambda: (UniformDisk(), rough()),
    "torch-features": lambda: (UniformDisk(), Tilted()),
    "columns-torch": lambda: ("improved-baseline", Tilted()),
    "columns-mitsuba": lambda: ("two-lobe", normal_mapped()),
    "native": lambda: ("native", normal_mapped()),
}


@pytest.fixture(params=PAIRS)
def pair(request) -> tuple[Method, Material]:
    """A method fitted to a material."""
    method, material = PAIRS[request.param]()
    return ready(method, material), material


# --- the BSDF --------------------------------------------------------------------------


def test_sample(pair):
    """The weight is f cos / pdf; the density is the method's per solid angle."""
    method, material = pair
    n = 3000
    own = torch.Generator().manual_seed(1)
    condition, u = material.conditions(n, own), torch.rand(n, 3, generator=own)
    bsdf, si = SampledBSDF(material, method), interactions(condition, material)
    context = mi.BSDFContext()
    columns = [mi.Float(c.contiguous().numpy()) for c in u.T]
    bs, weight = bsdf.sample(context, si, columns[0], mi.Point2f(columns[1], columns[2]))
    wo, pdf = method.sample(condition, u)
    valid = (inside_disk(wo) & (pdf > 0)).numpy()
    assert 0.5 < valid.mean() <= 1
    found, direction, density = numpy(weight), numpy(bs.wo), numpy(bs.pdf)
    # Rounding decides on which side of the rim a point next to it is.
    off = ~valid & ((wo.square().sum(-1) - 1).abs() > 1e-6).numpy()
    assert (found[off] == 0).all() and (density[off] == 0).all()
    np.testing.assert_allclose(direction[valid, :2], wo.numpy()[valid], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(direction[valid], axis=1), 1, rtol=1e-6)
    # At the rim the cosine is the difference of two numbers near one.
    well = valid & (cos_theta(wo) > 0.02).numpy()
    assert well.sum() > 0.98 * valid.sum()
    expected = (pdf * cos_theta(wo)).numpy()
    np.testing.assert_allclose(density[well], expected[well], rtol=1e-3)
    # eval and pdf of the very direction that was sampled.
    value, again = bsdf.eval_pdf(context, si, bs.wo)
    ratio = numpy(value)[valid] / numpy(again)[valid, None]
    np.testing.assert_allclose(found[valid], ratio, rtol=1e-3, atol=1e-6)
    # The material's own answer, in the protocol's terms.
    f = method.eval(condition, wo).numpy()[well]
    np.testing.assert_allclose(found[well], f / pdf.numpy()[well, None], rtol=2e-3, atol=1e-5)


def test_pdf_and_eval(pair):
    """At directions of the caller's."""
    method, material = pair
    n = 2000
    own = torch.Generator().manual_seed(2)
    condition = material.conditions(n, own)
    wo = 0.999 * square_to_disk(torch.rand(n, 2, generator=own))
    bsdf, si = SampledBSDF(material, method), interactions(condition, material)
    direction = vector(wo, cos_theta(wo))
    value, pdf = (numpy(v) for v in bsdf.eval_pdf(mi.BSDFContext(), si, direction))
    assert np.array_equal(value, numpy(bsdf.eval(mi.BSDFContext(), si, direction)))
    assert np.array_equal(pdf, numpy(bsdf.pdf(mi.BSDFContext(), si, direction)))
    cos = cos_theta(wo)
    np.testing.assert_allclose(pdf, (method.pdf(condition, wo) * cos).numpy(), rtol=1e-3, atol=1e-6)
    expected = method.eval(condition, wo) * cos[:, None]
    np.testing.assert_allclose(value, expected.numpy(), rtol=1e-3, atol=1e-5)


def test_wrong_side(pair):
    """From below, to below, or switched off: nothing, without a nan."""
    method, material = pair
    n = 600
    own = torch.Generator().manual_seed(3)
    condition, u = material.conditions(n, own), torch.rand(n, 3, generator=own)
    kind = torch.arange(n) % 4
    bsdf, si = SampledBSDF(material, method), interactions(condition, material, kind == 1)
    context = mi.BSDFContext()
    active = mi.Mask((kind != 3).numpy())
    columns = [mi.Float(c.contiguous().numpy()) for c in u.T]
    bs, weight = bsdf.sample(context, si, columns[0], mi.Point2f(columns[1], columns[2]), active)
    off = ((kind == 1) | (kind == 3)).numpy()
    assert (numpy(weight)[off] == 0).all() and (numpy(bs.pdf)[off] == 0).all()
    assert (numpy(bs.pdf)[~off] > 0).mean() > 0.4
    wo = 0.99 * square_to_disk(u[:, :2])
    direction = vector(wo, torch.where(kind == 2, -1, 1) * cos_theta(wo))
    off |= (kind == 2).numpy()
    value, pdf = bsdf.eval_pdf(context, si, direction, active)
    assert (numpy(value)[off] == 0).all() and (numpy(pdf)[off] == 0).all()
    assert (numpy(value)[~off] > 0).any(1).mean() > 0.9
    assert np.isfinite(numpy(weight)).all() and np.isfinite(numpy(value)).all()


def test_nothing_active():
    """A method in torch is then not called at all."""

    class Uncallable(UniformDisk):
        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            raise AssertionError("called without rows")

    material = White()
    si = interactions(material.conditions(5, torch.Generator()), material)
    _, weight = SampledBSDF(material, ready(Uncallable(), material)).sample(
        mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5, 0.5), mi.Mask(False)
    )
    assert (numpy(weight) == 0).all()


def test_own_eval_is_used():
    """A method that changes the reflectance is rendered with its own, not the material's."""

    class Dimmed(UniformDisk):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            return 0.5 * super().eval(condition, wo)

    for material in (white(), White()):
        image = prepare(SCENE, material, ready(Dimmed(), material), 8)
        assert image.render(4, 0).mean[image.mask] == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("kind", ["torch-torch", "columns-mitsuba", "native"])
def test_mitsubas_own_chi_square(kind):
    """Mitsuba's test of samples against the density, seen through the plugin."""
    method, material = PAIRS[kind]()
    found = mitsuba_chi2(ready(method, material), material, samples=200_000)
    assert found and all(f.ok for f in found), [f for f in found if not f.ok]


# --- renders ---------------------------------------------------------------------------

SCENE = scenes.make("uniform-sphere")


def test_torch_and_columns_give_one_image():
    """The same formulas on either side of the bridge, from the same random numbers."""
    material = rough()
    light = scenes.make("studio-sphere")
    a, b = (
        prepare(light, material, ready(m, material), 24).render(16, 3)
        for m in ("cosine", UniformDisk())
    )
    np.testing.assert_allclose(a.rgb, b.rgb, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(a.variance, b.variance, rtol=1e-2, atol=1e-2)


def test_methods_agree_with_mitsuba():
    """Mean images of methods of ours, and of two of Mitsuba's own strategies."""
    material, light, spp = rough(), scenes.make("studio-sphere"), 512
    all_prepared = [
        prepare(light, material, ready(m, material), 32)
        for m in ("cosine", "native", "improved-baseline", Correct())
    ]
    all_prepared += [prepare_native(light, material, 32, s) for s in ("mis", "bsdf")]
    renders = [p.render(spp, seed) for seed, p in enumerate(all_prepared)]
    mask = all_prepared[0].mask
    assert all(np.array_equal(p.mask, mask) for p in all_prepared)
    found = agreement([r.mean for r in renders], [r.variance / spp for r in renders], mask)
    assert min(a.p_value for a in found) > 1e-3 / len(found)
    # Nor is the test blind: five per cent too bright is seen.
    biased = [renders[0].mean * 1.05, renders[4].mean]
    noise = [renders[0].variance / spp, renders[4].variance / spp]
    assert agreement(biased, noise, mask)[0].p_value < 1e-3


@pytest.mark.parametrize("make", [white, White], ids=["mitsuba", "torch"])
@pytest.mark.parametrize(
    "method", ["cosine", "improved-baseline", "two-lobe", "tabulated", "native", Correct]
)
def test_white_furnace(make, method):
    """A surface that reflects all light is as bright as the light, everywhere."""
    material = make()
    size = {"resolution": 16} if method == "tabulated" else {}
    method = method() if callable(method) else registry.make(method, **size)
    if not method.supports(material)[0]:
        pytest.skip("has no sampler of its own")
    spp = 64
    prepared = prepare(SCENE, material, ready(method, material), 24)
    done = prepared.render(spp, 1)
    mask = prepared.mask
    error = math.sqrt(done.variance[mask].mean() / spp / mask.sum())
    # The mesh shades a touch of light away where the sphere's normals leave its facets.
    assert done.mean[mask].mean() == pytest.approx(1, abs=5 * error + 1e-4)
    worst = np.abs(done.mean[mask] - 1).max()
    assert worst < 6 * math.sqrt(done.variance[mask].max() / spp) + 0.02
    np.testing.assert_allclose(done.rgb[mask].mean(0), np.ones(3), atol=5 * error + 1e-4)


def test_variance_is_that_of_independent_renders():
    """Of one sample per pixel each, by their own scatter."""
    material = Plaster()
    prepared = prepare(SCENE, material, ready("cosine", material), 12)
    mask = prepared.mask
    singles = [prepared.render(1, seed) for seed in range(150)]
    assert all(np.isnan(s.variance).all() for s in singles)
    scatter = np.array([s.mean for s in singles])[:, mask]
    many = prepared.render(600, 1000)
    assert many.spp == 600 and many.seconds > 0
    found, expected = many.variance[mask], scatter.var(0, ddof=1)
    # Relative error of a variance of n values is at least sqrt(2 / n), here of 150 x pixels.
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)
    assert np.median(expected / found) == pytest.approx(1, abs=0.15)
    difference = scatter.mean(0) - many.mean[mask]
    z = difference / np.sqrt(found * (1 / 150 + 1 / 600))
    assert (z**2).mean() == pytest.approx(1, abs=5 * math.sqrt(2 / len(z)))


def test_passes_add_up(monkeypatch):
    """A render split into passes is one render: moments pooled, samples not repeated."""
    material = Plaster()
    prepared = prepare(SCENE, material, ready("cosine", material), 12)
    mask = prepared.mask
    whole = prepared.render(256, 5)
    monkeypatch.setattr(passes, "LANES", 144 * 24)
    split = prepared.render(256, 5)
    assert split.spp == 256 and not np.array_equal(split.mean, whole.mean)
    assert split.mean[mask].mean() == pytest.approx(whole.mean[mask].mean(), rel=0.02)
    assert split.variance[mask].mean() == pytest.approx(whole.variance[mask].mean(), rel=0.1)
    two = [
        (a.mean - b.mean)[mask].var() for a, b in ((split, whole), (prepared.render(256, 6), split))
    ]
    assert two == pytest.approx([2 * whole.variance[mask].mean() / 256] * 2, rel=0.5)


def test_seeds():
    """Equal seeds give equal images; different ones are independent."""
    material = rough()
    prepared = prepare(SCENE, material, ready("cosine", material), 12)
    mask = prepared.mask
    first, same, other = (prepared.render(8, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.mean, same.mean)
    noise = [(r.mean - r.mean[mask].mean())[mask] for r in (first, other)]
    assert not np.array_equal(*noise)
    shared = np.mean((first.mean - other.mean)[mask] ** 2)
    assert shared == pytest.approx(2 * first.variance[mask].mean() / 8, rel=0.5)


def test_mask():
    """Pixels wholly on the sphere: its disk, less the silhouette."""
    prepared = prepare(SCENE, White(), ready(UniformDisk(), White()), 32)
    mask = prepared.mask
    assert mask.shape == (32, 32) and mask.dtype == bool
    # The sphere's disk has radius tan(14.48 deg) / tan(14.8 deg) of half of the image.
    edge = 16 * math.tan(math.asin(0.25)) / math.tan(math.radians(29.6 / 2))
    y, x = np.mgrid[:32, :32] - 15.5
    corner = np.hypot(np.abs(x) + 0.5, np.abs(y) + 0.5)
    assert mask[corner < edge - 0.1].all()
    assert not mask[corner > edge + 0.35].any()
    # Wherever the mask is, light is seen; far off the sphere there is none.
    mean = prepared.render(4, 0).mean
    assert (mean[mask] > 0).all() and mean[0, 0] == 0


@pytest.mark.parametrize("where", ["pdf", "wo"])
def test_nan_is_not_hidden(where):
    """One bad sample in a thousand reaches the image, and the render is refused."""
    material = rough()
    prepared = prepare(SCENE, material, ready(SometimesNan(where), material), 16)
    done = prepared.render(64, 0)
    assert not np.isfinite(done.rgb[prepared.mask]).all()

    class Job:
        method, material = prepared.bsdf.method, prepared.bsdf.material

    with pytest.raises(FloatingPointError, match=r"sometimes-nan on principled: \d+ of 256 pixels"):
        checked(done, Job)
    good = prepare(SCENE, material, ready("cosine", material), 16).render(4, 0)
    assert checked(good, Job) is good


def test_nan_of_the_reflectance_is_not_hidden():
    """Nor is one of a method's own ``eval``."""

    class NanValue(UniformDisk):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            value = super().eval(condition, wo)
            return torch.where(wo[:, :1].abs() < 0.01, math.nan, value)

    material = White()
    prepared = prepare(SCENE, material, ready(NanValue(), material), 16)
    assert not np.isfinite(prepared.render(64, 0).rgb[prepared.mask]).all()


def test_symbolic_render_beside_a_method_in_torch():
    """Mitsuba's own mode traces all BSDFs alive; one in torch is not in its way, nor hidden."""
    material = rough()
    torch_one = prepare(SCENE, material, ready(UniformDisk(), material), 8)
    native = prepare_native(SCENE, material, 8)
    assert native.symbolic and np.isfinite(native.render(8, 0).rgb).all()
    torch_one.symbolic = True
    assert not np.isfinite(torch_one.render(8, 0).rgb[torch_one.mask]).any()
    torch_one.symbolic = False
    assert np.isfinite(torch_one.render(8, 0).rgb).all()


def test_evaluated_mode_restores_flags():
    """Also after an error, and whatever they were before."""
    flags = (dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicLoops)
    before = [dr.flag(f) for f in flags]
    try:
        for wanted in ((True, True), (False, True)):
            for f, value in zip(flags, wanted, strict=True):
                dr.set_flag(f, value)
            with passes.evaluated_mode():
                assert not any(dr.flag(f) for f in flags)
            assert tuple(dr.flag(f) for f in flags) == wanted
            with pytest.raises(KeyError), passes.evaluated_mode():
                raise KeyError
            assert tuple(dr.flag(f) for f in flags) == wanted
    finally:
        for f, value in zip(flags, before, strict=True):
            dr.set_flag(f, value)


def test_method_that_raises_in_a_render():
    """Its own error arrives, and Mitsuba can be used on."""

    class Broken(UniformDisk):
        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            raise ArithmeticError("no luck")

    material = White()
    before = dr.flag(dr.JitFlag.SymbolicCalls)
    with pytest.raises(Exception) as raised:  # noqa: PT011  Dr.Jit wraps it in one of its own
        prepare(SCENE, material, ready(Broken(), material), 8).render(2, 0)
    causes, error = [], raised.value
    while error is not None:
        causes.append(str(error))
        error = error.__cause__ or error.__context__
    assert "no luck" in causes
    assert dr.flag(dr.JitFlag.SymbolicCalls) == before
    good = prepare(SCENE, material, ready("cosine", material), 8)
    assert good.render(2, 0).mean[good.mask] == pytest.approx(1, abs=1e-4)


def test_native_needs_mitsuba():
    """A material in torch has no renders of Mitsuba's own."""
    with pytest.raises(Unsupported, match="'white' is no Mitsuba BSDF"):
        prepare_native(SCENE, White(), 8)


# --- a user's file ---------------------------------------------------------------------

XML = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="80"/> <integer name="height" value="40"/>
      <rfilter type="gaussian"/>
    </film>
  </sensor>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
  <bsdf type="diffuse" id="glaze"><rgb name="reflectance" value="0.1"/></bsdf>
  <bsdf type="diffuse" id="wall"><rgb name="reflectance" value="0.2"/></bsdf>
  <shape type="sphere">
    <point name="center" x="-0.5" y="0" z="0"/> <float name="radius" value="0.3"/>
    <ref id="glaze"/>
  </shape>
  <shape type="sphere">
    <point name="center" x="50" y="0" z="0"/> <float name="radius" value="0.3"/>
    <bsdf type="diffuse" id="inline"><rgb name="reflectance" value="0.3"/></bsdf>
  </shape>
  <shape type="rectangle">
    <transform name="to_world">
      <scale value="0.3"/> <translate x="0.5" y="0" z="0"/>
    </transform>
    <ref id="wall"/>
  </shape>
</scene>"""


def xml_scene(folder: Path, replaced: str):
    """The file, written, with one of its BSDFs to be replaced."""
    (folder / "room.xml").write_text(XML)
    return scenes.make({"file": "room.xml", "replace_bsdf": replaced}, folder)


@pytest.mark.parametrize("kind", ["torch", "columns"])
def test_xml_scene(tmp_path, kind):
    """One BSDF is ours, the rest of the file is the user's."""
    material = White(0.7) if kind == "torch" else mitsuba("diffuse", reflectance=0.7)
    method = ready(Correct() if kind == "torch" else "cosine", material)
    prepared = prepare(xml_scene(tmp_path, "glaze"), material, method, 40)
    done, mask = prepared.render(64, 0), prepared.mask
    assert done.mean.shape == mask.shape == (20, 40)
    assert prepared.bsdf.method is method
    # Half of the sphere's light comes past the rectangle beside it: both are unoccluded.
    assert mask[:, 20:].sum() == 0 and mask[:, :20].sum() > 20
    error = math.sqrt(done.variance[mask].mean() / 64 / mask.sum())
    # The rectangle, of reflectance 0.2, hides a little of the light from the sphere.
    assert done.mean[mask].mean() == pytest.approx(0.7, abs=5 * error + 0.01)
    wall = done.mean[9:11, 24:27]
    assert wall == pytest.approx(0.2, abs=0.03)
    assert (tmp_path / "room.xml").read_text() == XML


def test_xml_scene_replaces_what_was_named(tmp_path):
    """By id, wherever it stands; and each pair of method and material is its own."""
    for albedo in (0.3, 0.9):
        material = White(albedo)
        method = ready(UniformDisk(), material)
        prepared = prepare(xml_scene(tmp_path, "wall"), material, method, 40)
        assert prepared.mask[:, :20].sum() == 0 and prepared.mask.sum() > 10
        mean = prepared.render(16, 0).mean[prepared.mask]
        assert mean.mean() == pytest.approx(albedo, abs=0.03)
    prepared = prepare(xml_scene(tmp_path, "inline"), material, method, 8)
    assert isinstance(prepared.bsdf, SampledBSDF) and not prepared.mask.any()


def test_xml_scene_that_mitsuba_refuses(tmp_path):
    """One line that names the file."""
    scene = xml_scene(tmp_path, "glaze")
    scene.file.write_text(XML.replace('type="constant"', 'type="no-such-light"'))
    material = White()
    with pytest.raises(InputError, match=r"room.xml': Mitsuba cannot load it") as refused:
        prepare(scene, material, ready(UniformDisk(), material), 8)
    assert "\n" not in str(refused.value)


def test_xml_scene_has_no_native_render(tmp_path):
    """Which the caller is told."""
    with pytest.raises(Unsupported, match="user's file"):
        prepare_native(xml_scene(tmp_path, "glaze"), white(), 8)
