"""The measures, on methods and materials whose numbers are known beforehand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.convergence import curve_of
from harness.core import registry
from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.fitting.targets import tabulate
from harness.measures import adapter_smoke_test
from harness.measures.base import Outcome
from harness.mitsuba_runtime import variant
from tests.fakes import FakeMaterial
from tests.measure_subjects import (
    Nan,
    Sleepy,
    Still,
    Uneven,
    assert_same_bytes,
    job,
    measured,
    pdf,
    values,
)
from tests.measuring import run
from tests.planted import Correct, Plaster

variant.use("cpu")

PLASTER = Plaster()
"""One for all: its reference images are made once."""


class TooLarge(Correct):
    """Its density is ten per cent too large, so its images are too dark."""

    name = "too-large"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return 1.1 * super().pdf(condition, wo)


class Rare(Uneven):
    """Right, but three samples in a hundred thousand carry a tenth of the light."""

    name = "rare"
    outside, rare = 0.1, 3e-5

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        inside = 1 - self.outside
        low = torch.where(u[:, 2] < self.rare, inside, 0)
        width = torch.where(u[:, 2] < self.rare, self.outside, inside)
        r, turn = (low + width * u[:, 0]).sqrt(), 2 * math.pi * u[:, 1]
        wo = 0.999999 * r[:, None] * torch.stack([turn.cos(), turn.sin()], -1)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        inside = wo.square().sum(-1) < 0.999999**2 * (1 - self.outside)
        times = torch.where(inside, (1 - self.rare) / (1 - self.outside), self.rare / self.outside)
        return times * super().pdf(condition, wo)


# --- equal samples ---------------------------------------------------------------------


def equal_spp(method: Method, material: Material, spp: int = 64) -> Outcome:
    """The measure at a size for tests."""
    given = {"resolution": 16, "reference_spp": 1024, "longest": 1}
    return measured("equal-spp", method, material, batches=6, spp=spp, **given)


def test_variance_is_the_chi_square_divergence():
    """Under constant light, of any method: by formula, and by the other measure."""
    grey, still, share = FakeMaterial("grey"), Still(), 0.5
    right = values(equal_spp(Uneven(), grey))
    assert right["relative-variance"] == pytest.approx(0, abs=2e-4)
    wrong = values(equal_spp(Uneven(share), grey))
    expected = (1 / share + 1 / (2 - share)) / 2 - 1
    assert wrong["relative-variance"] == pytest.approx(expected, rel=0.02)
    lost = values(equal_spp(Uneven(lost=0.25), grey))
    assert lost["relative-variance"] == pytest.approx(1 / 3, rel=0.02)
    # A bump's radiance is the same from everywhere, but in colour: luminance is compared.
    cosine = registry.make("cosine")
    analytic = tabulate(still, torch.zeros(1, 2), 256).double().flatten()
    expected = float(analytic.square().mean() / analytic.mean() ** 2 - 1)
    assert values(equal_spp(cosine, still))["relative-variance"] == pytest.approx(
        expected, rel=0.05
    )
    assert pdf(cosine, still)["chi2"] == pytest.approx(expected, rel=0.05)


def test_bias():
    """A density ten per cent too large is found out; a right one is not accused."""
    biased, right = (equal_spp(m, PLASTER) for m in (TooLarge(), Correct()))
    found = values(biased)
    assert found["bias-p"] < 1e-4 and found["bias-z"] < -4
    assert found["bias"] == pytest.approx(1 / 1.1 - 1, abs=0.03)
    assert values(right)["bias-p"] > 1e-3
    assert abs(values(right)["bias"]) < 0.03
    for outcome in (biased, right):
        assert outcome.arrays["batch_variance"].shape == (6,)
        assert (
            outcome.arrays["blocks"].shape == outcome.arrays["reference_blocks"].shape == (4, 1, 1)
        )
        assert outcome.images["mean"].shape == (16, 16, 3)
    assert values(right)["spp"] == 6 * 64
    # The first render's reference is that of the other, which had no second.
    assert_same_bytes(biased, right, names=("pixels",))
    reference = biased.arrays["first_reference_blocks"]
    assert reference.tobytes() == right.arrays["reference_blocks"].tobytes()
    assert not any(name.startswith("first") for name in right.arrays)
    variance = {r.metric: r for r in right.records}["variance"]
    assert 0 < variance.ci_low < variance.value < variance.ci_high


@pytest.mark.slow
def test_a_heavy_tail_is_rendered_anew():
    """Its first image lacks what rare samples carry, and their variance: not a wrong density."""
    from harness.measures import equal_spp as module

    methods = Rare(), TooLarge(), Correct()
    rare, biased, right = (values(equal_spp(m, PLASTER, spp=16)) for m in methods)
    assert rare["first-bias-p"] < module.DOUBT < rare["bias-p"]
    assert rare["spp"] == module.LONGER * 6 * 16
    # A wrong density stays wrong, and what agrees at once is left at that.
    assert biased["first-bias-p"] < module.DOUBT and biased["bias-p"] < 1e-12
    assert right["first-bias-p"] == right["bias-p"] and right["spp"] == 6 * 16


def test_reference_of_a_method_in_torch():
    """Mitsuba's own render of the material is made while the method is in a scene."""
    from harness.materials.mitsuba_bsdf import MitsubaMaterial

    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    found = values(equal_spp(Uneven(0.7), MitsubaMaterial("half", bsdf, {"type": "test"})))
    assert found["bias-p"] > 1e-3 and abs(found["bias"]) < 0.05


@pytest.mark.parametrize("name", ["equal-spp", "equal-time", "convergence"])
def test_renders_with_nan_are_refused(name):
    """Instead of measured."""
    jobs = [job(name, Nan(), FakeMaterial("grey"), baseline=True, resolution=8)]
    with pytest.raises(FloatingPointError, match="nan on grey: .* pixels are not finite"):
        run(name, jobs)


# --- convergence -----------------------------------------------------------------------


def test_convergence():
    """One over the number of samples, for one method and another beside it."""
    given = {"levels": 6, "repeats": 6, "resolution": 16, "reference_spp": 4096}
    jobs = [
        job("convergence", m, PLASTER, baseline=i == 0, **given)
        for i, m in enumerate((registry.make("cosine"), Correct()))
    ]
    for outcome in run("convergence", jobs):
        found = values(outcome)
        assert found["slope"] == pytest.approx(-1, abs=0.15)
        assert outcome.arrays["errors"].shape == (6, 6)
        arrays = curve_of(outcome.arrays)
        assert arrays["spp"].tolist() == [1, 2, 4, 8, 16, 32]
        assert arrays["seconds"].shape == (6,)
        assert (arrays["mse_low"] <= arrays["mse"]).all()
        assert (arrays["mse"] <= arrays["mse_high"]).all()
        assert found["mse-last"] == arrays["mse"][-1]
        ratio = arrays["mse"][0] / arrays["mse"][-1]
        assert ratio == pytest.approx(32, rel=0.35)


def test_convergence_of_a_biased_method_levels_off():
    """At the square of its bias: the error of its last level is more than noise explains."""
    given = {"levels": 8, "repeats": 2, "resolution": 16, "reference_spp": 2048}
    biased, right = (measured("convergence", m, PLASTER, **given) for m in (TooLarge(), Correct()))
    assert values(biased)["mse-last"] > 2 * values(right)["mse-last"]
    assert values(biased)["slope"] > values(right)["slope"]


def test_convergence_stops_in_time():
    """A slow method ends at an earlier level, alone."""
    given = {"levels": 5, "repeats": 1, "resolution": 8, "reference_spp": 64, "max_seconds": 0.1}
    jobs = [
        job("convergence", m, FakeMaterial("grey"), baseline=i == 0, **given)
        for i, m in enumerate((Sleepy(0.5), Sleepy(0.5)))
    ]
    for outcome in run("convergence", jobs):
        assert 1 <= len(outcome.arrays["spp"]) < 5
        assert np.isfinite(curve_of(outcome.arrays)["mse"]).all()


def test_uneven_is_a_correct_sampler():
    """What these tests rest on."""
    u = torch.rand(100_000, 3, generator=torch.Generator().manual_seed(0))
    method = Uneven(0.5, lost=0.2)
    wo, density = method.sample(torch.zeros(100_000, 2), u)
    inside = inside_disk(wo)
    assert float(inside.double().mean()) == pytest.approx(0.8, abs=0.01)
    assert float((wo[inside][:, 0] > 0).double().mean()) == pytest.approx(0.25, abs=0.01)
    assert float(wo[inside].square().sum(-1).double().mean()) == pytest.approx(0.5, abs=0.01)
    assert (density[~inside] == 0).all()
    points = square_to_disk(u[:, :2])
    mean = float(method.pdf(points, points).double().mean()) * math.pi
    assert mean == pytest.approx(0.8, abs=0.01)


def test_a_state_is_handed_over_on_the_device_of_the_materials(monkeypatch) -> None:
    """Adapters may keep theirs elsewhere; a material answers on one device alone."""
    method = registry.make("cosine")
    monkeypatch.setattr(method, "state_dict", lambda: {"a": torch.ones(2)})
    assert torch.equal(adapter_smoke_test.state_of(method)["a"], torch.ones(2))
    monkeypatch.setattr(adapter_smoke_test, "current", lambda: "meta")
    assert adapter_smoke_test.state_of(method)["a"].device.type == "meta"
