"""A method whose pdf is no more than an approximation, and what is made of it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
import torch

from harness.checks.approximate_pdf import as_declared, check_approximate_pdf
from harness.checks.finding import Finding
from harness.checks.run import run_checks
from harness.checks.subject import Case, Subject
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import Unsupported
from harness.materials import registry as materials
from harness.mitsuba_runtime import variant

variant.use("cpu")

from harness._methods.cosine import Cosine  # noqa: E402
from harness._methods.native import Native  # noqa: E402
from harness._methods.random_walk import RandomWalk  # noqa: E402
from harness.rendering.plugin import SampledBSDF  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402
from harness.scenes import registry as scenes  # noqa: E402
from harness.stats.ztest import agreement  # noqa: E402
from tests.materials import Plain  # noqa: E402
from tests.walks import family, rng  # noqa: E402

BRASS = {"alpha_x": 0.6, "alpha_y": 0.3, "r0_r": 0.95, "r0_g": 0.8, "r0_b": 0.4}


def bound(method, material):
    method.bind(material)
    return method


def test_material_without_walks():
    able, reason = RandomWalk().supports(Plain())
    assert not able and "plain" in reason
    with pytest.raises(Unsupported, match="plain"):
        RandomWalk().bind(Plain())


def test_weights_are_the_walks():
    """``sample`` and ``sample_weighted`` draw the same; the weight is not f/pdf."""
    material = materials.make("ggx-conductor")
    method = bound(RandomWalk(), material)
    condition, u = material.conditions(512, rng(0)), torch.rand(512, 3, generator=rng(1))
    wo, pdf, weight = method.sample_weighted(condition, u)
    assert torch.equal(method.sample(condition, u).wo, wo)
    walked = material.walk_sample(condition, u)
    assert torch.equal(walked[0], wo) and torch.equal(walked[1], weight)
    torch.testing.assert_close(method.pdf(condition, wo), pdf)
    ratio = material.eval(condition, wo) / pdf[:, None]
    assert ((ratio - weight).abs() > 0.05 * weight).any(1).float().mean() > 0.5
    assert method.sample_weighted(condition[:0], u[:0]).weight.shape == (0, 3)


def test_weights_by_default():
    """An exact pdf gives f/pdf, and zero off the disk."""
    material = materials.make("ggx-conductor")
    condition, u = material.conditions(2048, rng(2)), torch.rand(2048, 3, generator=rng(3))
    for method in (bound(Native(), material), bound(Cosine(), material)):
        wo, pdf, weight = method.sample_weighted(condition, u)
        inside = inside_disk(wo)
        expected = material.eval(condition, wo)[inside] / pdf[inside, None]
        torch.testing.assert_close(weight[inside], expected)
        assert (weight[~inside] == 0).all()
        assert method.exact_pdf and (method.name == "cosine" or not inside.all())


# --- checks ----------------------------------------------------------------------------


def approximate_pdf(method) -> dict[str, Finding]:
    """Findings of one condition, by name."""
    subject = Subject(method, method, method.material, "cpu", rng(7))
    case = Case("oblique", torch.tensor([0.5, -0.4]))
    return {f.property: f for f in check_approximate_pdf(subject, case, 1e-4)}


def test_checks_take_it_at_its_word():
    """What an approximate density cannot have is degraded; the walk's weights are tested."""
    found = run_checks(RandomWalk(), family("ggx-conductor", **BRASS), only=("samples-pdf",))
    assert all(f.ok for f in found), [f.line() for f in found if not f.ok]
    density = [f for f in found if f.property == "samples-pdf"]
    assert density and all(f.verdict == "degraded" for f in density)
    assert all("approximation, as declared" in f.text for f in density)
    found = approximate_pdf(bound(RandomWalk(), family("ggx-conductor", 4, **BRASS)))
    assert set(found) == {"invalid", "weights", "largest-weight", "tail-index"}
    assert all(f.verdict == "pass" for f in found.values())
    assert found["weights"].number > 0.9


class Brighter(RandomWalk):
    """Three per cent too bright."""

    def sample_weighted_columns(self, c, u):
        x, y, pdf, weight = super().sample_weighted_columns(c, u)
        return x, y, pdf, 1.03 * weight


class Divided(RandomWalk):
    """Divides by zero."""

    def sample_weighted_columns(self, c, u):
        x, y, pdf, weight = super().sample_weighted_columns(c, u)
        return x, y, pdf, weight / (x - x)


class Undeclared(RandomWalk):
    """Takes the approximation for a density."""

    exact_pdf = True


def test_planted_faults_are_found():
    material = family("ggx-conductor", 4, **BRASS)
    found = approximate_pdf(bound(Brighter(), material))["weights"]
    assert not found.ok and "sample weights: mean" in found.text and found.worst
    found = approximate_pdf(bound(Divided(), material))
    assert not found["weights"].ok and "not finite" in found["weights"].text
    findings = run_checks(Undeclared(), material, only=("samples-pdf",))
    assert any(f.property == "samples-pdf" and not f.ok for f in findings)


def test_only_the_density_is_excused():
    for name, excused in (("tail", True), ("weights", False), ("pdf-finite", False)):
        finding = Finding(name, "normal", "fail", "wrong", {"got": 1})
        assert as_declared(RandomWalk(), finding).ok == excused
        assert as_declared(Native(), finding) is finding


# --- renders ---------------------------------------------------------------------------


def test_the_plugin_uses_the_weights():
    """Mitsuba's value of a sample is the walk's throughput; its pdf is the approximation."""
    material = materials.make("ggx-conductor")
    method = bound(RandomWalk(), material)
    si = mi.SurfaceInteraction3f()
    uv = torch.rand(256, 2, generator=rng(4))
    condition = material.conditions(256, rng(5))
    condition[:, :-2] = material.places(uv)
    x, y = (mi.Float(c.contiguous().numpy()) for c in condition[:, -2:].T)
    si.wi = mi.Vector3f(x, y, mi.Float((1 - condition[:, -2:].square().sum(1)).sqrt().numpy()))
    si.uv = mi.Point2f(*(mi.Float(c.contiguous().numpy()) for c in uv.T))
    u = torch.rand(256, 3, generator=rng(6))
    columns = [mi.Float(c.contiguous().numpy()) for c in u.T]
    bs, value = SampledBSDF(material, method).sample(
        mi.BSDFContext(), si, columns[0], mi.Point2f(columns[1], columns[2])
    )
    wo, pdf, weight = method.sample_weighted(condition, u)
    np.testing.assert_allclose(np.asarray(value).T, weight.numpy(), rtol=1e-4)
    cos = np.asarray(bs.wo.z)
    np.testing.assert_allclose(np.asarray(bs.pdf), pdf.numpy() * cos, rtol=2e-3)


@pytest.mark.parametrize("sampling", ["bsdf", "mis"])
def test_renders_agree(sampling):
    """The walk, with and without light samples, and two samplers whose density is exact."""
    material, light, spp = family("ggx-conductor", 8, **BRASS), scenes.make("studio-sphere"), 128
    methods = [RandomWalk(), Native(), Cosine()]
    made = [prepare(light, material, bound(m, material), 24, sampling) for m in methods]
    renders = [p.render(spp, seed) for seed, p in enumerate(made)]
    mask = made[0].mask
    found = agreement([r.mean for r in renders], [r.variance / spp for r in renders], mask)
    assert min(a.p_value for a in found) > 1e-3 / len(found)
    biased = [renders[0].mean * 1.1, renders[1].mean]
    noise = [r.variance / spp for r in renders[:2]]
    assert agreement(biased, noise, mask)[0].p_value < 1e-3
