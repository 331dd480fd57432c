"""``import harness``: materials, fits, samples, pictures, suites and plugins from a script."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import harness

ROUGH = {"type": "roughconductor", "alpha": 0.4}
SMALL = harness.Budget(steps=20, conditions=32, directions=16, resolution=16, pool=64)


class Uniform(harness.Method):
    """Uniform on the disk, in torch."""

    def sample(self, condition, u):
        return harness.DiskSample(
            harness.square_to_disk(u[:, :2]), u.new_full((len(u),), 1 / math.pi)
        )

    def pdf(self, condition, wo):
        inside = wo.square().sum(1) < 1
        return torch.where(inside, 1 / math.pi, 0.0)


@pytest.fixture(scope="module")
def fitted() -> harness.Sampler:
    return harness.fit("improved-baseline", ROUGH, SMALL)


def test_public_names_are_there_and_few():
    assert len(harness.__all__) <= 24
    for name in harness.__all__:
        assert getattr(harness, name).__doc__, name
    assert set(harness.__all__) <= set(dir(harness))


def test_importing_it_loads_nothing_heavy():
    heavy = ("torch", "mitsuba", "pandas", "pydantic")
    code = f"import harness, sys; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "spec",
    [
        "suede",
        ROUGH,
        {"name": "mine", "type": "mitsuba", "bsdf": ROUGH},
        {"type": "family", "family": "ggx-conductor", "fix": {"r0_r": 0.9}},
    ],
    ids=["name", "mitsuba", "suite", "family"],
)
def test_a_material(spec):
    made = harness.material(spec)
    assert isinstance(made, harness.Material)
    assert harness.material(made) is made
    assert torch.isfinite(made.eval(made.conditions(4, torch.Generator()), torch.zeros(4, 2))).all()


def test_a_material_of_a_bsdf():
    import mitsuba as mi

    harness.material("suede")  # sets the variant
    made = harness.material(mi.load_dict(ROUGH), "metal")
    condition = torch.tensor([[0.3, 0.1]])
    same = harness.material(ROUGH).eval(condition, torch.tensor([[-0.2, 0.0]]))
    assert torch.equal(made.eval(condition, torch.tensor([[-0.2, 0.0]])), same)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: harness.material("sued"), "did you mean 'suede'"),
        (lambda: harness.material(3), "expected a name"),
        (lambda: harness.material({"type": "dielectric"}), "delta lobe"),
        (lambda: harness.fit("cosin", "suede"), "did you mean 'cosine'"),
        (lambda: harness.fit("cosine", "suede", sigma=2), "unknown parameter 'sigma'"),
        (lambda: harness.fit(int, "suede"), "subclass of harness.Method"),
        (lambda: harness.render(3), "what harness.fit gives"),
        (lambda: harness.render(harness.fit("cosine", "suede"), "nowhere"), "unknown scene"),
        (lambda: harness.render(harness.fit("cosine", "suede"), spp=0), "spp: expected"),
        (lambda: harness.fit("cosine", "suede").sample(torch.zeros(3, 9)), "expected the shape"),
        (lambda: harness.run({"name": "x"}), "missing key 'materials'"),
        (lambda: harness.run("smok"), "did you mean 'smoke'"),
        (lambda: harness.load_sampler("nowhere", "a", "b"), "no results"),
    ],
)
def test_what_is_refused(call, message):
    with pytest.raises(harness.InputError) as refused:
        call()
    assert message in str(refused.value)


def test_samples_have_the_density_that_they_say(fitted):
    condition = fitted.conditions(1, seed=3).expand(20_000, -1)
    wo, pdf = fitted.sample(condition, seed=1)
    torch.testing.assert_close(pdf, fitted.pdf(condition, wo), rtol=1e-3, atol=1e-5)
    assert not (wo.is_inference() or pdf.requires_grad)
    # The mean of 1/pdf over samples is the area of where they may fall, which holds the disk.
    inside = wo.square().sum(1) < 1
    assert (inside / pdf).mean().item() == pytest.approx(math.pi, rel=0.1)
    assert fitted.eval(condition, wo).shape == (20_000, 3)


def test_a_fit_is_that_of_a_suite(tmp_path):
    """And the stored one is taken up as it is, by a path and by a dictionary."""
    budget = {"steps": 20, "conditions": 32, "directions": 16, "resolution": 16, "pool": 64}
    suite = {
        "name": "mine",
        "materials": [{"name": "metal", "type": "mitsuba", "bsdf": ROUGH}],
        "methods": ["cosine", {"name": "improved-baseline"}, Uniform],
        "measures": [{"name": "pdf", "conditions": 8, "resolution": 32, "samples": 32}],
        "budget": budget,
    }
    table = harness.run(suite, tmp_path / "out", quiet=True)
    assert set(table.status) == {"ok"} and {"kl", "fit-seconds"} <= set(table.metric)
    assert set(table.method) == {"cosine", "improved-baseline", "Uniform"}
    again = harness.run(suite, tmp_path / "out", quiet=True)
    assert again.value.equals(table.value)
    stored = harness.load_sampler(tmp_path / "out", "metal", "improved-baseline")
    own = harness.fit("improved-baseline", ROUGH, harness.Budget(**budget))
    for name, tensor in own.method.state_dict().items():
        assert torch.equal(stored.method.state_dict()[name], tensor), name
    condition = own.conditions(16)
    assert torch.equal(stored.sample(condition)[0], own.sample(condition)[0])
    for label, message in (("improved", "did you mean"), ("cosine", "no seed 4")):
        with pytest.raises(harness.InputError, match=message):
            harness.load_sampler(tmp_path / "out", "metal", label, seed=4)


def test_a_class_without_a_file_is_no_part_of_a_suite():
    made = type("Made", (Uniform,), {"__module__": "__main__"})
    with pytest.raises(harness.InputError, match=r"file.py:Class"):
        harness.run({"name": "x", "methods": [made]})


def test_a_picture_of_ones_own_method():
    image = harness.render(harness.fit(Uniform, ROUGH), "uniform-sphere", resolution=16, spp=64)
    assert image.rgb.shape == (16, 16, 3) and np.isfinite(image.rgb).all()
    other = harness.render(harness.fit("cosine", ROUGH), "uniform-sphere", 16, 64, seed=1)
    error = math.sqrt((image.variance + other.variance).mean() / 64 / image.mean.size)
    assert image.mean.mean() == pytest.approx(other.mean.mean(), abs=5 * error)


@pytest.mark.parametrize(
    "methods",
    ["Uniform, 'cosine'", pytest.param("'improved-baseline',", marks=pytest.mark.slow)],
    ids=["plain", "fitted"],
)
def test_a_plugin_in_ones_own_script_renders_what_mitsuba_does(methods):
    """In a process of its own, with Mitsuba's ordinary calls and flags."""
    here = Path(__file__)
    code = f"""
import sys; sys.path.insert(0, {str(here.parents[1])!r})
import mitsuba as mi; mi.set_variant("llvm_ad_rgb")
import numpy as np, harness
from tests.test_api import ROUGH, SMALL, Uniform
def scene(bsdf):
    look = mi.ScalarTransform4f().look_at([0, -4, 1], [0, 0, 0], [0, 0, 1])
    film = {{"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {{"type": "box"}}}}
    return mi.load_dict({{"type": "scene", "integrator": {{"type": "path", "max_depth": 4}},
        "sensor": {{"type": "perspective", "to_world": look, "film": film}},
        "ball": {{"type": "sphere", "bsdf": bsdf}}, "sky": {{"type": "constant"}},
        "lamp": {{"type": "point", "position": [3, -3, 3], "intensity": 9.0}}}})
native = np.array(mi.render(scene(ROUGH), spp=128, seed=1))
for method in ({methods}):
    own = np.array(mi.render(scene(harness.fit(method, ROUGH, SMALL).bsdf()), spp=128, seed=1))
    assert np.isfinite(own).all(), np.isnan(own).mean()
    print(own.mean(), native.mean())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = done.stdout.split("\n")[:-1]
    assert len(rows) == methods.count("'") // 2 + methods.count("Uniform")
    for row in rows:
        own, native = map(float, row.split())
        assert own == pytest.approx(native, rel=0.015)


class Gradient(Uniform):
    """Asks a gradient by what it is given to fit to."""

    def fit(self, material, budget, generator):
        condition = material.conditions(32, generator, budget.device)
        wo = harness.square_to_disk(torch.rand(32, 2, generator=generator))
        weight = torch.nn.Parameter(torch.ones(condition.shape[1]))
        f = material.target(condition, wo)
        value = material.eval(condition, wo)
        given = [condition, f, value, material.target_grid(condition, wo[None])]
        assert not any(tensor.is_inference() for tensor in given)
        (((condition * weight).sum(1) - f).square() + value.sum(1) * weight[0]).mean().backward()
        assert torch.isfinite(weight.grad).all()
        if not material.why_no_gradient():
            value, slope = material.target_gradient(condition, wo)
            assert not (value.is_inference() or slope.is_inference())
        f.add_(1)  # and may be written to
        self.bind(material)
        return harness.FitReport()


@pytest.mark.parametrize(
    "spec",
    [
        "suede",
        ROUGH,
        {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
        "ggx-conductor",
        "leather",
    ],
    ids=str,
)
def test_tensors_given_to_a_fit_are_ordinary(spec):
    """A loss made of them can be differentiated, on every kind of material."""
    harness.fit(Gradient, spec)
