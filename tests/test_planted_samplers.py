"""What a table must say of planted samplers: a clone, one that does all twice, lossy ones."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis import pooling
from harness.analysis.integral import variance_of
from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.core.record import Raw
from harness.measures.base import Outcome
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.variance import Deviations, diagnosed
from harness.store.stored import Stored
from tests.fakes import FakeMaterial
from tests.measure_subjects import Uneven, job, measured, values
from tests.measuring import run
from tests.planted import Correct, Plaster
from tests.test_measures import Rare

variant.use("cpu")

PLASTER = Plaster()
scene_of = functools.cache(scenes.make)
"""One of each for all tests: reference images are made once for a material in a scene."""


class Lossy(Correct):
    """Says a density that is too large, and so loses ``share`` of the energy everywhere."""

    name = "lossy"

    def __init__(self, share: float = 0.01):
        self.share = share

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        return DiskSample(wo, pdf / (1 - self.share))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo) / (1 - self.share)


def stored(outcome: Outcome) -> Stored:
    """As a store gives it back."""
    return Stored("key", {}, {}, "ok", "", reader=lambda *_: outcome.arrays)


def equal_spp(method: Method, material: Material, scene: str, **given: object) -> Outcome:
    """Of one method, as fast as a test has to be; a bias is judged by a longer reference."""
    settings = {"batches": 6, "spp": 32, "resolution": 24, "reference_spp": 64} | given
    one = job("equal-spp", method, material, **settings)
    return run("equal-spp", [replace(one, scene=scene_of(scene))])[0]


# --- bias ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "share"), [("uniform-sphere", 0.01), ("studio-sphere", 0.02)])
def test_a_small_loss_of_energy_is_found(scene: str, share: float) -> None:
    """And a sampler that loses none is not accused."""
    given = {"power_seconds": 200.0, "reference_seconds": 200.0, "longest": 1000}
    given["reference_spp"] = 1024
    right = values(equal_spp(Correct(), PLASTER, scene, **given))
    assert right["bias-p"] > 1e-3 and right["bias-power-reached"] == 1
    assert right["bias-detectable"] < share / 1.8
    lossy = values(equal_spp(Lossy(share), PLASTER, scene, **given))
    assert lossy["first-bias-p"] < 1e-3 and lossy["bias-p"] < 1e-3


def test_a_loss_of_energy_is_found() -> None:
    """Rendered until the test finds 5 %, which is less than a sampler loses of 7 %."""
    given = {"detect": 0.05, "resolution": 16, "reference_spp": 256}
    lossy = values(equal_spp(Lossy(0.07), PLASTER, "uniform-sphere", **given))
    assert lossy["first-bias-p"] < 1e-3 and lossy["bias-p"] < 1e-3


def test_too_short_a_render_says_so() -> None:
    found = values(equal_spp(Correct(), PLASTER, "uniform-sphere", longest=1, spp=4))
    assert found["bias-power-reached"] == 0 and found["bias-detectable"] > 0.005
    # Of a difference of that error: two quantiles, of the level and of the power.
    assert found["bias-detectable"] == pytest.approx(5.13 * found["bias-error"], rel=0.01)


# --- speed-ups -----------------------------------------------------------------------------------


def test_a_clone_is_one_and_a_sampler_that_does_all_twice_a_half() -> None:
    """By the pairs of renders alone, though one went on for longer; times are made up."""
    given = {"resolution": 16, "longest": 1}
    base = equal_spp(Correct(), PLASTER, "uniform-sphere", **given)
    clone = equal_spp(Correct(), PLASTER, "uniform-sphere", **given | {"batches": 8})
    drift = np.random.default_rng(0).lognormal(0, 0.1, 8)
    rounds = np.stack([drift, drift * (1 + 0.01 * np.array([1, -1, 2, -2, 3, -3, 1, -1]))])
    pair = [pooling.variance_of(stored(outcome), None) for outcome in (base, clone)]
    ratio = pooling.variance_ratio(*pair)
    assert ratio.interval == (1.0, 1.0, 1.0)
    alike = pooling.speed_up(ratio, *rounds)
    assert alike.interval.low < 1 < alike.interval.high and alike.log.factor < 1.1
    twice = pooling.speed_up(ratio, rounds[0], 2 * rounds[1]).interval
    assert twice.low < 0.5 < twice.high


def test_all_renders_of_a_cell_are_pooled() -> None:
    """By their samples: those of equal samples, and the timed ones of other random numbers."""
    material = PLASTER
    same = equal_spp(Uneven(0.6), material, "uniform-sphere", longest=1, resolution=16)
    given = {"rounds": 3, "max_rounds": 3, "spp": 16, "resolution": 16, "deadline": 0.05}
    jobs = [job("equal-time", Uneven(0.6), material, i == 0, **given) for i in range(2)]
    base, timed = run("equal-time", jobs)
    assert (base.arrays["batch_variance"] != timed.arrays["batch_variance"]).all()
    found = pooling.variance_of(stored(same), stored(timed))
    parts = [float(o.arrays["batch_variance"].mean()) for o in (same, timed)]
    assert found.spp == 6 * 32 + 3 * 16
    expected = (6 * 32 * parts[0] + 3 * 16 * parts[1]) / found.spp
    assert found.variance.value == pytest.approx(expected, rel=1e-6)
    alone = [pooling.variance_of(*p) for p in ((stored(same), None), (None, stored(timed)))]
    assert found.variance.log.factor < min(p.variance.log.factor for p in alone)
    # Without what tells a tail, as in an older store, nothing is pooled.
    del same.arrays["deviations"]
    assert pooling.variance_of(stored(same), None) is None


# --- what is sampled too rarely ------------------------------------------------------------------


def test_the_other_samples_find_the_same_variance() -> None:
    """Of a method in torch and of one over columns, in an environment map too."""
    for method in (Uneven(0.4), registry.make("cosine")):
        for scene in ("uniform-sphere", "studio-sphere"):
            outcome = equal_spp(
                method, PLASTER, scene, longest=1, spp=128, resolution=16, max_seconds=1e3
            )
            plain = float(outcome.arrays["batch_variance"].mean())
            other = pooling.other_variance(outcome.arrays)
            apart = abs(np.log(other.value / plain))
            assert apart < 2 * other.log.above + 0.02, (method.name, scene)
            assert other.tail != "not resolved"


# --- constant light ------------------------------------------------------------------------------


def test_the_integral_is_the_formula() -> None:
    """Of uneven halves and of lost samples, for a grey surface."""
    # Lost samples are counted, two at each of some 4000 points: 0.25 within 0.0047.
    for method, expected, factor in (
        (Uneven(0.5), (1 / 0.5 + 1 / 1.5) / 2 - 1, 1.02),
        (Uneven(lost=0.25), 1 / 3, math.exp(2 * 1.3 * 1.96 * 0.0047 * 3)),
    ):
        outcome = measured("constant-light", method, FakeMaterial("grey"), resolution=32)
        found = variance_of(outcome.arrays)
        # Twice the interval: four standard errors.
        assert abs(found.total.value - expected) < 2 * expected * found.total.log.above
        assert found.total.log.factor < factor
        # The same albedo everywhere: no part of the footprint, within its noise.
        assert abs(found.footprint.value) < 1e-3 * expected


@pytest.mark.slow
def test_the_integral_is_what_long_renders_find() -> None:
    exact = variance_of(measured("constant-light", Correct(), PLASTER, resolution=24).arrays)
    long = equal_spp(Correct(), PLASTER, "uniform-sphere", longest=1, spp=512)
    rendered = pooling.variance_of(stored(long), None).variance
    error = np.hypot(exact.total.log.above, rendered.log.above)
    assert abs(exact.total.log.theta - rendered.log.theta) < 2 * error < 0.04


@pytest.mark.slow
def test_the_integral_knows_rare_samples() -> None:
    """Of a sampler with one sample in a thousand where most of the variance is."""
    exact = variance_of(measured("constant-light", Rare(), PLASTER, resolution=24).arrays)
    long = equal_spp(Rare(), PLASTER, "uniform-sphere", longest=1, spp=8192, max_seconds=1e3)
    plain = Deviations.unpacked(long.arrays["deviations"])
    mean = float(long.arrays["batch_variance"].mean())
    assert abs(exact.total.value - mean) < 4 * np.hypot(
        plain.error, exact.total.value * exact.total.log.above / 1.96
    )


def test_the_footprint_is_what_a_perfect_sampler_keeps() -> None:
    """A texture that varies over a pixel, under a sampler without variance of its own."""

    class Striped(FakeMaterial):
        """Lambertian, its albedo a sine of the place."""

        n_features = 1

        def places(self, uv: Tensor) -> Tensor:
            """See :meth:`Material.places`."""
            return 0.5 + 0.4 * torch.sin(90 * uv[:, :1])

        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            """See :meth:`Material.eval`."""
            return super().eval(condition, wo) * condition[:, :1]

    outcome = measured("constant-light", registry.make("cosine"), Striped("s"), resolution=24)
    found = variance_of(outcome.arrays)
    assert found.total.value == pytest.approx(found.footprint.value, rel=0.02)
    rendered = equal_spp(registry.make("cosine"), Striped("s"), "uniform-sphere", longest=1)
    assert values(rendered)["variance"] == pytest.approx(found.total.value, rel=0.1)


@pytest.mark.parametrize("scene", ["studio-sphere"])
def test_light_that_is_not_constant_is_refused(scene: str) -> None:
    from harness.core.protocol.errors import Unsupported

    one = job("constant-light", Uneven(), PLASTER)
    with pytest.raises(Unsupported, match="not constant"):
        run("constant-light", [replace(one, scene=scenes.make(scene))])


# --- bad input -----------------------------------------------------------------------------------


def test_no_variance_at_all_is_no_number() -> None:
    """Uniform sampling of a constant: no interval is invented, and no ratio."""
    outcome = equal_spp(Uneven(), FakeMaterial("grey"), "uniform-sphere", longest=1)
    found = pooling.variance_of(stored(outcome), None)
    other = pooling.variance_of(
        stored(equal_spp(Uneven(0.5), FakeMaterial("grey"), "uniform-sphere", longest=1)), None
    )
    assert found.variance.value < 1e-3
    # What rounding leaves of it has no interval; exactly none has no logarithm either.
    assert not pooling.variance_ratio(other, found).resolved
    exact = replace(found, variance=diagnosed(0.0, Deviations.of(np.zeros((6, 9)))))
    assert pooling.variance_ratio(other, exact) is None


def test_an_older_store_keeps_its_numbers_and_is_not_diagnosed() -> None:
    from harness.analysis.records import equal_spp as records

    outcome = equal_spp(Correct(), PLASTER, "uniform-sphere", longest=1, resolution=16)
    kept = ("batch_variance", "blocks", "reference_blocks", "pixels", "spp")
    old = {name: outcome.arrays[name] for name in kept}
    found = {r.metric: r for r in records.numbers(Raw(old, {}, {})).records}
    assert "tail-resolved" not in found and "bias-error" in found
    assert found["variance"].ci_low < found["variance"].value < found["variance"].ci_high


def test_integrals_of_the_same_points_are_paired() -> None:
    """A clone is one; the ratio of two samplers is that of their formulas."""
    from harness.analysis.constant_light import preferred

    grey = FakeMaterial("grey")
    base, clone, other = (
        preferred(stored(measured("constant-light", m, grey, resolution=24)), None)
        for m in (Uneven(0.5), Uneven(0.5), Uneven(lost=0.5))
    )
    same = pooling.variance_ratio(base, clone)
    assert same.exact and same.interval == (1.0, 1.0, 1.0)
    ratio = pooling.variance_ratio(base, other)
    assert ratio.log.theta == pytest.approx(np.log(1 / 3), abs=0.02)
    assert preferred(None, base) is base
