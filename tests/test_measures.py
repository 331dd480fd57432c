"""The measures, on methods and materials whose numbers are known beforehand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.slices import divergences
from harness.core import registry
from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.fitting.targets import tabulate
from harness.measures import adapter_smoke_test
from harness.measures.base import Outcome
from tests.fakes import FakeMaterial
from tests.known_methods import (
    Exact,
    Nan,
    Rare,
    Still,
    TooLarge,
    Uneven,
    assert_same_bytes,
    job,
    measured,
    values,
)
from tests.materials import Plain
from tests.measuring import run
from tests.planted import Correct, Plaster

# --- pdf -------------------------------------------------------------------------------


def pdf(method: Method, material: Material) -> dict[str, float]:
    """The measure at a size for tests."""
    return values(measured("pdf", method, material, conditions=16, resolution=32, samples=1024))


@pytest.mark.parametrize("share", [1.0, 0.5, 1.9])
def test_pdf_of_known_divergence(share):
    """On a Lambertian, by formula."""
    found = pdf(Uneven(share), FakeMaterial("grey"))
    assert found["kl"] == pytest.approx(-(math.log(share) + math.log(2 - share)) / 2, abs=1e-5)
    chi2 = (1 / share + 1 / (2 - share)) / 2 - 1
    assert found["chi2"] == pytest.approx(chi2, rel=1e-4, abs=1e-5)
    assert found["chi2-median"] == pytest.approx(chi2, rel=1e-4, abs=1e-5)
    assert found["mse"] == pytest.approx(((share - 1) / math.pi) ** 2, abs=1e-6)
    assert found["lost-share"] == found["invalid-share"] == 0
    assert found["black-conditions"] == found["negative-share"] == 0


def test_pdf_with_invalid_samples():
    """They are missing from the density, and counted."""
    found = pdf(Uneven(lost=0.25), FakeMaterial("grey"))
    assert found["kl"] == pytest.approx(math.log(4 / 3), abs=1e-5)
    assert found["chi2"] == pytest.approx(1 / 3, abs=1e-5)
    assert found["invalid-share"] == pytest.approx(0.25, abs=5 * math.sqrt(0.19 / 16 / 1024))
    assert found["lost-share"] == 0


def test_pdf_that_misses_light():
    """Infinite is what it is, with the share of light that is lost beside it."""
    found = pdf(Uneven(share=0), FakeMaterial("grey"))
    assert found["kl"] == found["chi2"] == found["chi2-median"] == math.inf
    assert found["lost-share"] == pytest.approx(0.5, abs=1e-6)
    assert found["mse"] == pytest.approx(1 / math.pi**2, rel=1e-5)


def test_pdf_without_a_density():
    """A nan of the method is no number of the measure."""
    found = pdf(Nan(), FakeMaterial("grey"))
    assert math.isnan(found["kl"]) and math.isnan(found["chi2"]) and math.isnan(found["lost-share"])


def test_pdf_of_the_target_itself():
    """Nothing but the quadrature's own noise."""
    found = pdf(Exact(), Still())
    assert abs(found["kl"]) < 2e-3 and abs(found["chi2"]) < 2e-3


def test_pdf_facts_of_the_material():
    """Black conditions have no p*; negative values are counted."""

    class Odd(FakeMaterial):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            value = super().eval(condition, wo)
            value = torch.where(wo[:, 1:] < 0, -value, value)
            return torch.where(condition[:, :1] < 0, 0, value)

    outcome = measured("pdf", Uneven(), Odd("odd"), conditions=64, resolution=16)
    found = values(outcome)
    assert 16 < found["black-conditions"] < 48
    lit = 64 - int(found["black-conditions"])
    assert found["negative-share"] == pytest.approx(0.5 * lit / 64, abs=0.05)
    # |f| is the target, and |f| is constant.
    assert found["kl"] == pytest.approx(0, abs=1e-5)
    assert outcome.arrays["condition"].shape == (lit, 2)
    assert all(len(outcome.arrays[n]) == lit for n in ("kl", "chi2", "mse", "invalid-share"))
    assert (outcome.arrays["condition"][:, 0] >= 0).all()


def test_pdf_uses_the_same_conditions_for_all_methods():
    """So that their differences are theirs."""
    outcomes = [measured("pdf", m, Plain(), conditions=8) for m in (Uneven(), Uneven(0.3))]
    assert_same_bytes(*outcomes, names=("condition", "negative-share"))


# --- slices ----------------------------------------------------------------------------


def test_slices():
    """Pictures over [-1, 1]^2, y down the rows; nan off the disk and only there."""
    outcome = measured("slices", Uneven(0.5), Still(), count=2, grid=64)
    target, density = outcome.arrays["target"], outcome.arrays["pdf"]
    assert target.shape == density.shape == (2, 64, 64)
    axis = (np.arange(64) + 0.5) / 32 - 1
    x, y = np.meshgrid(axis, axis)
    off = np.hypot(x, y) >= 1
    for image in (target, density):
        assert np.isnan(image[:, off]).all() and np.isfinite(image[:, ~off]).all()
    assert np.nansum(target, (1, 2)) * (2 / 64) ** 2 == pytest.approx([1, 1])
    right = np.where(x > 0, 0.5, 1.5) / math.pi
    np.testing.assert_allclose(density[0][~off], right[~off], rtol=1e-5)
    row, column = np.unravel_index(np.nanargmax(target[0]), (64, 64))
    # Still's bump is at -0.8 * 0.25 on both axes.
    assert (axis[column], axis[row]) == pytest.approx((-0.2, -0.2), abs=2 / 64)
    assert outcome.arrays["condition"].shape == (2, 2)
    kl, mse = divergences(outcome.arrays)
    assert kl.shape == mse.shape == (2,) and (kl > 0.1).all()
    assert mse == pytest.approx(np.nanmean((target - density) ** 2, (1, 2)))
    assert values(outcome)["kl-mean"] == pytest.approx(kl.mean())


def test_slices_have_one_target_for_all_methods():
    outcomes = [measured("slices", m, Still(), count=1, grid=16) for m in (Uneven(), Uneven(0.5))]
    assert_same_bytes(*outcomes, names=("target", "condition"))


def test_slices_of_the_target_itself():
    """Divergence near nothing; p* and p are one picture."""
    arrays = measured("slices", Exact(), Still(), count=1, grid=64).arrays
    assert abs(divergences(arrays)[0]).max() < 5e-3
    np.testing.assert_allclose(arrays["pdf"], arrays["target"], rtol=0.02)


# --- equal samples ---------------------------------------------------------------------


def equal_spp(method: Method, material: Material, spp: int = 64) -> Outcome:
    """The measure at a size for tests."""
    return measured(
        "equal-spp", method, material, batches=6, spp=spp, resolution=16, reference_spp=1024
    )


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
    biased, right = (equal_spp(m, Plaster()) for m in (TooLarge(), Correct()))
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


def test_a_heavy_tail_is_rendered_anew():
    """Its first image lacks what rare samples carry, and their variance: not a wrong density."""
    from harness.measures import equal_spp as module

    methods = Rare(), TooLarge(), Correct()
    rare, biased, right = (values(equal_spp(m, Plaster(), spp=16)) for m in methods)
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
