"""The timed measures: equal time, throughput."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from torch import Tensor

from harness.analysis.records.throughput import OWN_TIMES
from harness.core import registry
from harness.core.protocol.errors import BudgetExceeded
from harness.core.protocol.method import DiskSample
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.mitsuba_runtime import variant
from tests.measure_subjects import Sleepy, Uneven, job, measured, values
from tests.measuring import run
from tests.planted import Correct, Plaster

variant.use("cpu")

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


def test_pictures():
    """An image of each, the reference with the baseline's; the error is that of the image."""
    given = {"picture_size": 16, "deadline": 0.05, "reference_spp": 64}
    material = Plaster()
    methods = [Uneven(0.4), Uneven()]
    jobs = [job("pictures", m, material, baseline=i == 1, **given) for i, m in enumerate(methods)]
    uneven, base = run("pictures", jobs, lambda said: None)
    assert set(uneven.images) == {"picture"} and set(base.images) == {"picture", "reference"}
    mask, right = base.arrays["mask"], base.images["reference"]
    for outcome in (uneven, base):
        found = values(outcome)
        assert outcome.images["picture"].shape == (16, 16, 3) == right.shape
        assert found["spp-achieved"] == outcome.arrays["chunk_spp"].sum()
        off = (outcome.images["picture"] - right)[mask].mean(1)
        power = np.square(right[mask].mean(1)).mean()
        # Grey, so that luminance is the mean; the reference has noise of its own.
        assert found["relative-mse"] == pytest.approx(np.square(off).mean() / power, rel=0.5)
    ratio = uneven.arrays["variance"] / base.arrays["variance"]
    assert ratio > 1  # what chooses the wrong half has the larger variance


@pytest.mark.parametrize(("a_sample", "counts", "known"), [
    (0.001, [1, 1, 3, 2, 4, 8, 16, 32, 64, 128], 0.001 + 0.01 / 128),
    (1.0, [1, 1], 1.01),
])  # fmt: skip
def test_a_pictures_warm_up_knows_the_speed(monkeypatch, a_sample, counts, known):
    """Of a render long enough that what every render costs hardly counts; and all is compiled."""
    from harness.measures import pictures

    asked: list[tuple[int, int]] = []

    def render(self, spp: int, seed: int):
        asked.append((spp, seed))
        return SimpleNamespace(seconds=0.01 + a_sample * spp)

    monkeypatch.setattr(pictures._Entrant, "render", render)
    assert pictures._Entrant(None, None).warm_up(100, 0.4) == pytest.approx(known)
    assert [spp for spp, _ in asked] == counts
    assert len({seed for _, seed in asked}) == len(asked)


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
