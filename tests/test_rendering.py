"""A method and its material as one Mitsuba BSDF, and renders with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core import registry
from harness.core.protocol.errors import InputError, Unsupported
from harness.core.protocol.method import DiskSample
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.ztest import agreement
from tests.planted import Correct, Plaster

mi = variant.use("cpu")

import drjit as dr  # noqa: E402  a variant has to be set first

from harness.measures.images import checked  # noqa: E402
from harness.rendering import passes  # noqa: E402
from harness.rendering.plugin import SampledBSDF  # noqa: E402
from harness.rendering.prepared import prepare, prepare_native  # noqa: E402
from tests.render_subjects import SCENE, UniformDisk, White, mitsuba, ready, rough, white  # noqa: E402


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


def test_xml_scene_by_mitsuba_alone(tmp_path):
    """The material's own BSDF in the user's file, and the image of the cosine agrees with it."""
    material = mitsuba("diffuse", reflectance=0.7)
    native = prepare_native(xml_scene(tmp_path, "glaze"), material, 40)
    own = prepare(xml_scene(tmp_path, "glaze"), material, ready("cosine", material), 40)
    assert native.bsdf is material.bsdf
    (a, b), mask = (ready_.render(64, 3) for ready_ in (native, own)), own.mask
    error = math.sqrt((a.variance[mask].mean() + b.variance[mask].mean()) / 64 / mask.sum())
    assert a.mean[mask].mean() == pytest.approx(b.mean[mask].mean(), abs=5 * error + 1e-4)
