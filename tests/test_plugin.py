"""A method as a Mitsuba BSDF: samples, densities, values, call by call."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.core.protocol.disk import cos_theta, inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.mitsuba_runtime import variant
from tests.materials import Tilted, normal_mapped
from tests.planted import Correct, Plaster

mi = variant.use("cpu")

import drjit as dr  # noqa: E402  a variant has to be set first

from harness.checks.mitsuba_chi2 import mitsuba_chi2  # noqa: E402
from harness.rendering.plugin import SampledBSDF  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402
from tests.render_subjects import SCENE, UniformDisk, White, ready, rough, white  # noqa: E402


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
