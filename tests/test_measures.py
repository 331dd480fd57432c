"""The measures, on methods and materials whose numbers are known beforehand."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.convergence import curve_of
from harness.analysis.records.slices import divergences
from harness.analysis.records.throughput import OWN_TIMES
from harness.core import registry
from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, Method
from harness.fitting.targets import cells, tabulate
from harness.materials import registry as materials
from harness.measures import adapter_smoke_test
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from tests.fakes import FakeMaterial
from tests.materials import Plain
from tests.measuring import run
from tests.planted import Correct, Plaster

variant.use("cpu")

SCENE = scenes.make("uniform-sphere")


class Still(Plain):
    """A bump that stays where it is, whatever ``wi``: every condition has the same p*."""

    name = "still"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        return super().eval(torch.full_like(condition, 0.25), wo)


class Uneven(Method):
    """Constant on each half of the disk: ``share / pi`` for x >= 0, ``(2 - share) / pi`` below.

    Against a uniform p*, with s the share, KL = -(ln s + ln(2 - s)) / 2 and
    chi-square = (1 / s + 1 / (2 - s)) / 2 - 1. ``lost`` of the samples are invalid.
    """

    name = "uneven"

    def __init__(self, share: float = 1.0, lost: float = 0.0):
        self.share, self.lost = share, lost

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        turn = math.pi * (u[:, 1] - 0.5)
        wo = 0.999999 * u[:, :1].sqrt() * torch.stack([turn.cos(), turn.sin()], -1)
        # Stretched to [0, 1) over the valid samples.
        pick = (u[:, 2] - self.lost) / (1 - self.lost)
        right = pick < self.share / 2
        wo = torch.where(right[:, None], wo, wo * torch.tensor([-1.0, 1.0]))
        wo = torch.where(pick[:, None] < 0, torch.tensor([2.0, 0.0]), wo)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        half = torch.where(wo[:, 0] > 0, self.share, 2 - self.share)
        return torch.where(inside_disk(wo), (1 - self.lost) * half / math.pi, 0)


class Exact(Uneven):
    """The density of :class:`Still`, for what needs no samples of it."""

    name = "exact"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        total = Still().target_grid(condition[:1], cells(256)[None]).mean() * math.pi
        return Still().target(condition, wo) / total


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


class Sleepy(Uneven):
    """As good as :class:`Uneven`, but slow."""

    name = "sleepy"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        time.sleep(0.06)
        return super().sample(condition, u)


class Nan(Uneven):
    """Without a density."""

    name = "nan"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo) * math.nan


def job(
    measure: str, method: Method, material: Material, baseline: bool = False, **given: Any
) -> Job:
    """One trial's job, as the runner makes it."""
    own = torch.Generator().manual_seed(0)
    method.fit(material, Budget(), own)
    return Job(
        trial=None,
        material=material,
        method=method,
        scene=SCENE if measures.load(measure).needs_scene else None,
        seed=0,
        generator=torch.Generator().manual_seed(0),
        settings=measures.settings(measure, given),
        budget=Budget(),
        make=lambda: type(method)(),
        baseline=baseline,
    )


def measured(name: str, method: Method, material: Material, **given: Any) -> Outcome:
    """Of one method."""
    return run(name, [job(name, method, material, **given)])[0]


def values(outcome: Outcome) -> dict[str, float]:
    """By metric."""
    assert outcome.status == "ok"
    found = {r.metric: r.value for r in outcome.records}
    assert len(found) == len(outcome.records)
    for r in outcome.records:
        assert not r.ci_low > r.value and not r.ci_high < r.value
    return found


def assert_same_bytes(*outcomes: Outcome, names: tuple[str, ...]) -> None:
    """What is the same for all methods is stored once: the arrays have the same bytes."""
    for name in names:
        first, *others = (o.arrays[name] for o in outcomes)
        for other in others:
            assert (other.dtype, other.tobytes()) == (first.dtype, first.tobytes()), name


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


# --- equal time ------------------------------------------------------------------------


def test_equal_time():
    """The baseline against itself is one; a sleeper is slower; arrays have their shapes."""
    material = Plaster()
    given = {"rounds": 5, "slice_seconds": 0.02, "deadline": 0.1, "resolution": 12, "warm_up": 0.4}
    given["max_rounds"] = 5
    methods = [Sleepy(), Uneven(), Uneven(0.4)]
    jobs = [job("equal-time", m, material, baseline=i == 1, **given) for i, m in enumerate(methods)]
    said: list[str] = []
    outcomes = run("equal-time", jobs, said.append)
    assert len(outcomes) == 3 and any("round 5 of 5" in text for text in said)
    sleepy, base, uneven = (values(o) for o in outcomes)
    for metric in ("speedup-equal-time", "speedup-equal-spp"):
        record = next(r for r in outcomes[1].records if r.metric == metric)
        assert (record.value, record.ci_low, record.ci_high) == (1, 1, 1)
    assert sleepy["seconds-per-spp"] > base["seconds-per-spp"]
    assert sleepy["samples-per-second"] < base["samples-per-second"]
    assert sleepy["speedup-equal-time"] < 1
    # Sleeping changes no sample, choosing the wrong half does.
    assert sleepy["speedup-equal-spp"] == pytest.approx(1, abs=0.6)
    for found, outcome in zip((sleepy, base, uneven), outcomes, strict=True):
        assert found["deadline-seconds"] == 0.1 and found["spp-achieved"] >= 1
        assert found["mse-at-deadline"] > 0 and found["achieved-seconds"] > 0
        assert found["achieved-seconds"] == pytest.approx(outcome.arrays["chunk_seconds"].sum())
        assert found["deadline-miss"] == pytest.approx(found["achieved-seconds"] / 0.1 - 1)
        assert found["deadline-missed"] == (abs(found["deadline-miss"]) > 0.015)
        assert found["disturbed"] in (0, 1)
        marked = found["disturbed"] or found["deadline-missed"]
        assert bool(outcome.reason) == bool(marked)
        assert outcome.arrays["loadavg"].shape == (3,)
        assert outcome.images["equal_time"].shape == (12, 12, 3)
        for name in ("seconds", "baseline_seconds", "batch_variance", "baseline_variance"):
            assert outcome.arrays[name].shape == (5,)
        assert (outcome.arrays["baseline_seconds"] == outcomes[1].arrays["seconds"]).all()
        assert outcome.arrays["mask"].shape == (12, 12)
        assert outcome.arrays["round_spp"] >= 2


class Glacial(Uneven):
    """0.15 s a row, and not to be asked for an image."""

    name = "glacial"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        if len(condition) > 1:
            raise AssertionError("was asked for an image")
        time.sleep(0.15)
        return super().sample(condition, u)


@pytest.mark.parametrize("name", ["equal-time", "convergence"])
def test_what_cannot_end_is_not_begun(name):
    """It becomes a timeout that says how long it would have taken; the others go on."""
    material = Plaster()
    given = {"resolution": 12, "patience": 60.0}
    given |= {"rounds": 3, "slice_seconds": 0.02, "deadline": 0.05} if name == "equal-time" else {}
    given |= {"levels": 3, "reference_spp": 16, "patience": 1.0} if name == "convergence" else {}
    jobs = [job(name, Glacial(), material, **given), job(name, Uneven(), material, True, **given)]
    slow, base = run(name, jobs)
    assert slow.status == "timeout" and "glacial needs about" in slow.reason
    assert base.status == "ok" and base.records


def test_equal_spp_does_not_begin_what_cannot_end():
    with pytest.raises(BudgetExceeded, match="needs about"):
        measured("equal-spp", Glacial(), Plaster(), resolution=12, patience=60.0)


def test_a_baseline_that_is_too_slow():
    given = {"rounds": 3, "resolution": 12, "patience": 1.0}
    with pytest.raises(BudgetExceeded, match="baseline"):
        run("equal-time", [job("equal-time", Glacial(), Plaster(), True, **given)])


def test_an_exact_sampler_is_infinitely_better():
    """Uniform sampling of a constant has no variance: no logarithm is taken of it."""
    material = materials.make(
        {"name": "flat", "type": "mitsuba", "bsdf": {"type": "diffuse", "reflectance": 0.5}}
    )
    given = {"rounds": 4, "slice_seconds": 0.02, "deadline": 0.05, "resolution": 12}
    exact, uneven = registry.make("cosine"), Uneven(0.4)
    jobs = [job("equal-time", exact, material, **given)]
    jobs.append(job("equal-time", uneven, material, True, **given))
    found = values(run("equal-time", jobs)[0])
    # Either nothing is left of the variance, or what rounding of the moments leaves.
    assert found["speedup-equal-time"] == math.inf or found["speedup-equal-spp"] > 1e3


@pytest.mark.parametrize(
    ("base", "method", "ratio"), [(1.0, 0.0, math.inf), (0.0, 1.0, 0.0), (0.0, 0.0, math.nan)]
)
def test_speed_up_of_no_variance(base, method, ratio):
    """Infinite, zero, or without meaning; and no interval."""
    from harness.analysis.records.equal_time import compare

    variances, seconds = (np.full(4, base), np.full(4, method)), (np.ones(4), np.ones(4))
    for value, low, high in compare(variances, seconds):
        assert value == ratio or (math.isnan(value) and math.isnan(ratio))
        assert math.isnan(low) and math.isnan(high)


# --- convergence -----------------------------------------------------------------------


def test_convergence():
    """One over the number of samples, for one method and another beside it."""
    given = {"levels": 6, "repeats": 6, "resolution": 16, "reference_spp": 4096}
    jobs = [
        job("convergence", m, Plaster(), baseline=i == 0, **given)
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
    biased, right = (
        measured("convergence", m, Plaster(), **given) for m in (TooLarge(), Correct())
    )
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


# --- throughput ------------------------------------------------------------------------


def test_throughput():
    """Rows a second of both calls, with their times; a slow method gets a smaller batch."""

    class PerRow(Uneven):
        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            time.sleep(4e-4 * len(u))
            return super().sample(condition, u)

    given = {"batch": 2048, "rounds": 3, "max_rounds": 3, "max_seconds": 0.2}
    jobs = [
        job("throughput", m, Plaster(), baseline=i == 0, **given)
        for i, m in enumerate((Correct(), PerRow()))
    ]
    good, slow = run("throughput", jobs)
    for outcome in (good, slow):
        found = values(outcome)
        rates = {"samples-per-second", "pdf-queries-per-second"}
        assert set(OWN_TIMES) == rates
        rest = {"batch", "sample-time-ratio", "pdf-time-ratio", "disturbed"}
        assert set(found) == rates | rest
        assert all(r.unit == ("1/s" if r.metric in rates else "1") for r in outcome.records)
        for name in ("sample", "pdf"):
            seconds = outcome.arrays[f"{name}_seconds"]
            assert seconds.shape == (3,) and (seconds > 0).all()
        expected = found["batch"] / np.median(outcome.arrays["sample_seconds"])
        assert found["samples-per-second"] == pytest.approx(expected)
    assert values(good)["batch"] == 2048
    assert values(slow)["batch"] < 2048
    assert values(slow)["samples-per-second"] < values(good)["samples-per-second"]


def test_throughput_of_exactly_so_many_rows() -> None:
    given = {"batch": 4096, "rows": 48, "rounds": 2, "max_rounds": 2, "least_seconds": 0.0}
    asked = job("throughput", Correct(), Plaster(), baseline=True, **given)
    (found,) = run("throughput", [asked])
    assert values(found)["batch"] == 48
    assert measures.make("throughput").later_processes(found) == {"rows": 48}


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
