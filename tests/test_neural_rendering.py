"""Neural materials inside Mitsuba: the BSDF plugin, images, footprints."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from harness.core import registry
from harness.materials.neural.material import NeuralMaterial
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from tests.test_neural_material import PYRAMID, SMALL, material, network

variant.use("cpu")

import drjit as dr  # noqa: E402  a variant has to be set first
import mitsuba as mi  # noqa: E402

from harness.rendering.plugin import SampledBSDF  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402


def ready(name: str, of: NeuralMaterial):
    method = registry.make(name)
    method.bind(of)
    return method


def interactions(n: int, seed: int = 3):
    """Surface interactions at random places and directions, with their tensors."""
    u = torch.rand(n, 4, generator=torch.Generator().manual_seed(seed))
    wi = 0.9 * (2 * u[:, 2:] - 1) / 2**0.5
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.uv = mi.Point2f(*(mi.Float(u[:, i].numpy()) for i in (0, 1)))
    x, y = (mi.Float(wi[:, i].numpy()) for i in (0, 1))
    si.wi = mi.Vector3f(x, y, dr.sqrt(1 - x * x - y * y))
    return si, u[:, :2], wi


def test_the_plugin_is_the_network():
    m = material()
    bsdf = SampledBSDF(m, ready("cosine", m))
    si, uv, wi = interactions(300)
    ctx = mi.BSDFContext()
    bs, value = bsdf.sample(ctx, si, mi.Float(0.3), mi.Point2f(0.4, 0.7))
    f = bsdf.eval(ctx, si, bs.wo)
    both, pdf = bsdf.eval_pdf(ctx, si, bs.wo)
    wo = torch.from_numpy(np.array(bs.wo)[:2].T.copy())
    cos = torch.from_numpy(np.array(bs.wo)[2])
    condition = m.condition_at(uv, wi)
    expected = (m.eval(condition, wo.expand(300, 2)) * cos[..., None]).numpy().T
    assert expected.max() > 0.01
    assert np.allclose(np.array(f), expected, atol=1e-5)
    assert np.array_equal(np.array(f), np.array(both))
    assert np.allclose(np.array(value), expected / np.array(bs.pdf), rtol=1e-4, atol=1e-5)
    assert np.allclose(np.array(pdf), np.array(bs.pdf), rtol=1e-5)


@pytest.mark.parametrize("architecture", [SMALL, PYRAMID], ids=["neusample", "neumip"])
def test_methods_render_one_image(architecture):
    """Cosine sampling and the untrained flow, with and without light sampling."""
    m = material(architecture)
    scene = scenes.make("uniform-sphere")
    passes = [
        prepare(scene, m, ready(name, m), 24, sampling).render(64, seed)
        for seed, (name, sampling) in enumerate(
            [("cosine", "bsdf"), ("neural-spline-flow", "bsdf"), ("cosine", "mis")]
        )
    ]
    assert passes[0].rgb.max() > 0.01
    for other in passes[1:]:
        assert agreement_of(passes[0], other)


def agreement_of(a, b) -> bool:
    """Mean images differ by no more than chance, over the whole picture (6 deviations)."""
    error = np.sqrt(np.nanmean((a.variance + b.variance) / a.spp) / a.mean.size)
    return abs(float((a.mean - b.mean).mean())) < 6 * error


def test_a_far_sphere_is_looked_up_at_a_coarser_level():
    """Levels of detail are seen by the renderer: ray differentials reach the material."""
    m = material(PYRAMID)
    seen = []
    inner = m._features

    def spy(uv, wi, level):
        seen.append(np.array(level))
        return inner(uv, wi, level)

    m._features = spy
    for resolution in (8, 64):
        prepare(scenes.make("uniform-sphere"), m, ready("cosine", m), resolution).render(1, 0)
    medians = [float(np.median(level[np.isfinite(level)])) for level in (seen[0], seen[-1])]
    # Eight times as many pixels a side: three levels finer.
    assert medians[0] - medians[1] == pytest.approx(3.0, abs=0.3)


def test_one_condition_serves_a_whole_query():
    m = material()
    calls = []
    inner = m.condition_columns
    m.condition_columns = lambda si: calls.append(1) or inner(si)
    bsdf = SampledBSDF(m, ready("cosine", m))
    si, _, _ = interactions(10)
    bsdf.sample(mi.BSDFContext(), si, mi.Float(0.3), mi.Point2f(0.4, 0.7))
    bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(0.1, 0.2, 0.97))
    assert len(calls) == 2
    assert bsdf.shared is None


def test_network_of_the_tests_is_not_flat():
    with torch.no_grad():
        shift = network(SMALL).offset(torch.rand(50, 2), torch.full((50, 2), 0.5))
    assert shift.std() > 0.05
