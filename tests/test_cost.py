"""What a method costs: counts that are known beforehand, and times that add up."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.cost import OWN_TIMES, shares
from harness.core import registry
from harness.core.protocol.errors import Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method
from harness.core.record import Raw
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job, Outcome
from harness.measures.cold_start import cold_starts
from harness.measures.memory import peak_bytes
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from tests.measuring import run
from tests.planted import Correct, Plaster

variant.use("cpu")

from harness.rendering.meter import PARTS, metered  # noqa: E402  after a variant is set
from harness.rendering.prepared import prepare  # noqa: E402

SCENE = scenes.make("uniform-sphere")
QUICK: dict[str, Any] = {
    "rounds": 3,
    "max_rounds": 3,
    "batch": 4096,
    "slice_seconds": 0.01,
    "warm_up": 0.2,
    "resolution": 16,
}


def fitted(method: Method, material: Material) -> Method:
    """Briefly."""
    method.fit(material, Budget(steps=2, pool=16, resolution=8), torch.Generator().manual_seed(0))
    return method


def job(measure: str, method: Method, material: Material, **changes: Any) -> Job:
    """As the runner makes it."""
    given = changes.pop("settings", {})
    kept: dict[str, Any] = {
        "trial": SimpleNamespace(method_name=method.name, params={}, material_spec=material.name),
        "material": material,
        "method": method,
        "scene": SCENE,
        "seed": 0,
        "generator": torch.Generator().manual_seed(0),
        "settings": measures.settings(measure, given),
        "budget": Budget(),
        "make": lambda: type(method)(),
    }
    return Job(**{**kept, **changes})


def values(outcome: Outcome) -> dict[str, float]:
    """By metric; every metric once."""
    assert outcome.status == "ok", outcome.reason
    found = {r.metric: r.value for r in outcome.records}
    assert len(found) == len(outcome.records)
    return found


# --- the meter -------------------------------------------------------------------------


class Sleepy(Correct):
    """Sleeps in every call of ``sample``."""

    name = "sleepy"
    pause = 0.03

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        time.sleep(self.pause)
        return super().sample(condition, u)


class SleepyPlaster(Plaster):
    """Sleeps in every evaluation."""

    name = "sleepy-plaster"
    pause = 0.05

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Material.eval`."""
        time.sleep(self.pause)
        return super().eval(condition, wo)


@pytest.mark.parametrize("name", ["cosine", "histogram"])
def test_a_metered_render_is_the_same_image(name):
    """A column method and one in torch, on a material of Mitsuba and one in torch."""
    for material in (Plaster(), materials.make("suede")):
        prepared = prepare(SCENE, material, fitted(registry.make(name), material), 16)
        bare = prepared.render(4, 7)
        with metered(prepared.bsdf) as meter:
            seen = prepared.render(4, 7)
        np.testing.assert_allclose(seen.rgb, bare.rgb, rtol=1e-5)
        assert meter.parts["sample"].rows > 0
        assert prepared.bsdf.meter is None


def test_without_a_meter_nothing_is_counted():
    """It is off again after its block, and a failure inside does not leave it on."""
    material = Plaster()
    prepared = prepare(SCENE, material, fitted(Correct(), material), 8)
    with pytest.raises(ZeroDivisionError), metered(prepared.bsdf) as meter:
        raise ZeroDivisionError
    prepared.render(2, 0)
    assert all(tally.calls == tally.rows == tally.seconds == 0 for tally in meter.parts.values())
    assert meter.points == meter.directions == 0


def test_counts_of_a_render():
    """Against the scene's own rays: each that hits the sphere is sampled once."""
    import mitsuba as mi

    material, side, spp = Plaster(), 16, 8
    prepared = prepare(SCENE, material, fitted(Correct(), material), side)
    with metered(prepared.bsdf) as meter:
        prepared.render(spp, 3)
    # The scene's own answer for other rays of the same pixels.
    rays = 1 << 16
    rng = np.random.default_rng(0)
    at = mi.Point2f(rng.random((2, rays)).astype("f"))
    sensor = prepared.scene.sensors()[0]
    ray, _ = sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5, 0.5))
    share = float(np.mean(np.array(prepared.scene.ray_intersect(ray).is_valid())))
    wanted = side * side * spp * share
    error = math.sqrt(side * side * spp * share * (1 - share))
    assert meter.points == pytest.approx(wanted, abs=5 * error)
    assert meter.parts["sample"].rows == meter.points
    assert meter.parts["sample"].calls == 1 == meter.parts["eval"].calls
    # Sampled by the BSDF alone, nobody asks for a density.
    assert meter.parts["pdf"].calls == meter.parts["pdf"].rows == 0
    # Only what points off the disk is dropped, a few lobes' tails.
    assert 0.5 * meter.points < meter.parts["eval"].rows <= meter.points
    assert meter.directions == meter.parts["eval"].rows


def test_half_of_the_samples_go_on():
    """Those that are valid are evaluated and traced; the others are shading points all the same."""

    class Half(Correct):
        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            wo, pdf = super().sample(condition, torch.cat([u[:, :2] * 0.3, u[:, 2:]], 1))
            off = u[:, 0] < 0.5
            return DiskSample(torch.where(off[:, None], 2.0, wo), torch.where(off, 0, pdf))

    material = Plaster()
    prepared = prepare(SCENE, material, fitted(Half(), material), 16)
    with metered(prepared.bsdf) as meter:
        prepared.render(16, 0)
    n = meter.points
    assert meter.directions == pytest.approx(n / 2, abs=5 * math.sqrt(n / 4))
    assert meter.parts["eval"].rows == meter.directions and meter.parts["sample"].rows == n


def test_density_and_evaluation_are_counted_apart():
    """Asked for by light sampling; here by hand."""
    import drjit as dr
    import mitsuba as mi

    from harness.rendering.passes import evaluated_mode

    material = Plaster()
    prepared = prepare(SCENE, material, fitted(Correct(), material), 8)
    si = dr.zeros(mi.SurfaceInteraction3f, 10)
    si.wi = mi.Vector3f(0, 0, dr.full(mi.Float, 1, 10))
    active = dr.arange(mi.UInt32, 10) < 4
    with evaluated_mode(), metered(prepared.bsdf) as meter:
        prepared.bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1), active)
    assert [meter.parts[part].rows for part in PARTS] == [0, 4, 4]
    assert [meter.parts[part].calls for part in PARTS] == [0, 1, 1]


def test_the_seconds_of_each_part_are_its_own():
    """A sleep is counted where it happens: the bound is from below, never from above."""
    material = SleepyPlaster()
    prepared = prepare(SCENE, material, fitted(Sleepy(), material), 8)
    prepared.render(2, 0)
    with metered(prepared.bsdf) as meter:
        rendered = prepared.render(2, 1)
    sample, value = meter.parts["sample"], meter.parts["eval"]
    assert sample.seconds >= Sleepy.pause * sample.calls
    assert value.seconds >= SleepyPlaster.pause * value.calls
    assert sample.calls == value.calls == 1 and meter.parts["pdf"].seconds == 0
    assert sample.seconds + value.seconds < rendered.seconds


# --- the measure -----------------------------------------------------------------------


def test_cost():
    """Records, their units and how they belong together."""
    material = Plaster()
    numbers = {"data-seconds": 0.25, "optimise-seconds": 2.0, "fit-seconds": 2.5, "loss": 1.0}
    settings = {**QUICK, "starts": 0}
    jobs = [
        job("cost", fitted(method, material), material, settings=settings, baseline=i == 0)
        for i, method in enumerate((Correct(), Sleepy()))
    ]
    jobs[1].fit_records = numbers
    base, sleepy = run("cost", jobs)
    for outcome in (base, sleepy):
        found = values(outcome)
        assert all(0 < found[f"{part}-share"] < 1 for part in ("sampling", "material", "rest"))
        kept = shares(Raw(outcome.arrays))
        np.testing.assert_allclose(sum(kept.values()), 1)
        for part in ("sampling", "material", "rest"):
            parts = kept[part] * outcome.arrays["bare_of_metered_seconds"]
            assert found[f"{part}-seconds-per-spp"] == pytest.approx(np.median(parts))
        assert found["seconds-per-spp"] == pytest.approx(np.median(outcome.arrays["seconds"]))
        per_row = np.median(outcome.arrays["sample_seconds"]) / found["batch"]
        assert found["seconds-per-million-samples"] == pytest.approx(1e6 * per_row)
        raw = Raw(outcome.arrays)
        metering = raw.floats("metered_seconds") / raw.floats("bare_of_metered_seconds")
        assert found["metering-overhead"] == pytest.approx(np.median(metering) - 1)
        # A ray that grazes the silhouette may hit the back by rounding: a point, no sample.
        assert found["sample-rows"] <= found["shading-points"]
        assert found["sample-rows"] == pytest.approx(found["shading-points"], rel=2e-3)
        assert 16 * 16 < found["rays"] <= 16 * 16 + found["shading-points"]
        assert found["pdf-calls"] == found["pdf-rows"] == 0
        assert 0 < found["sample-calls"] == found["eval-calls"] <= 0.5
        assert found["measuring-overhead"] > 0
        assert outcome.arrays["loadavg"].shape == (3,)
        assert len(outcome.arrays["sample_seconds"]) == 3
        # Its own renders, those beside the metered ones, and the baseline's beside the other's.
        times = 3 if outcome is base else 2
        assert len(outcome.arrays["batch_variance"]) == times * len(outcome.arrays["seconds"])
        assert (outcome.arrays["batch_variance"] > 0).all()
        units = {r.metric: r.unit for r in outcome.records}
        assert units["rays"] == "1/spp" and units["sampling-seconds-per-spp"] == "s"
        assert not {"load-seconds", "compile-seconds", "peak-bytes"} & set(found)
        assert set(OWN_TIMES) <= set(found)
        assert bool(found["disturbed"]) == outcome.reason.startswith("disturbed")
    for metric in ("sample-time-ratio", "pdf-time-ratio", "time-ratio"):
        assert values(base)[metric] == 1
    found = values(sleepy)
    # 30 ms a call, in the call and in the render that makes it.
    assert found["seconds-per-million-samples"] * found["batch"] / 1e6 >= Sleepy.pause
    slept = shares(Raw(sleepy.arrays))["sampling"] * sleepy.arrays["metered_seconds"]
    assert (slept * sleepy.arrays["round_spp"] >= Sleepy.pause).all()
    assert found["fit-data-seconds"] == 0.25 and found["fit-optimise-seconds"] == 2.0
    assert found["fit-seconds"] == 2.5
    assert not any(metric.startswith("fit-") for metric in values(base))


def test_cost_of_what_cannot_end():
    """Its reason says how long it would have taken; the others go on."""
    material = Plaster()
    settings = {**QUICK, "starts": 0, "patience": 5.0, "max_seconds": 0.05}

    class Glacial(Correct):
        name = "glacial"

        def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
            assert len(condition) < 64, "was asked for an image"
            time.sleep(0.11 * len(condition))
            return super().sample(condition, u)

    jobs = [
        job("cost", fitted(method, material), material, settings=settings, baseline=i == 0)
        for i, method in enumerate((Correct(), Glacial()))
    ]
    base, slow = run("cost", jobs)
    assert base.status == "ok" and slow.status == "timeout" and "needs about" in slow.reason


def test_cost_of_given_sizes():
    """What a later process is asked: the sizes of the first, and no cold starts."""
    material, measure = Plaster(), measures.make("cost")
    settings = {**QUICK, "starts": 0, "rows": 80, "spp": 5}
    asked = job("cost", fitted(Correct(), material), material, settings=settings, baseline=True)
    (found,) = run("cost", [asked])
    assert values(found)["batch"] == 80 and found.arrays["round_spp"] == 5
    assert measure.later_processes(found) == {"rows": 80, "spp": 5, "starts": 0}
    assert measure.later_processes(Outcome("timeout", "slow")) == {"starts": 0}


def test_cost_is_bound_to_the_machine():
    measure = measures.load("cost")
    assert measure.timed and measure.on_machine() and measure.needs_scene


# --- cold starts -----------------------------------------------------------------------


def test_cold_start_of_a_fitted_method():
    """Loaded twice, compiled each time, and the memory of one call."""
    material = materials.make("suede")
    method = fitted(registry.make("improved-baseline"), material)
    state = method.state_dict()
    rows = 1 << 18
    cold = cold_starts("improved-baseline", {}, "suede", state, "cpu", rows, 2)
    assert len(cold.load) == len(cold.compile) == 2
    assert all(seconds > 0 for seconds in cold.load)
    # A first call that compiles is no match for noise: the second start compiles again.
    assert all(seconds > 0 for seconds in cold.compile)
    assert method.size_bytes() < cold.size < method.size_bytes() + 8192
    # At least what it returns: wo and pdf, 12 bytes a row.
    assert cold.peak is not None and cold.peak >= 12 * rows and not cold.no_peak


def test_a_cold_start_that_fails_says_why():
    with pytest.raises(RuntimeError, match="no-such-method"):
        cold_starts("no-such-method", {}, "suede", {}, "cpu", 8, 1)


@pytest.mark.slow
def test_cold_start_of_a_method_without_a_state():
    cold = cold_starts("cosine", {}, "suede", {}, "cpu", 1024, 1)
    assert cold.size == 0 and len(cold.load) == 1


# --- memory ----------------------------------------------------------------------------


def test_peak_of_a_known_allocation():
    """100 MB written and given back: what is held afterwards is not the peak.

    In a process of its own, as the measure does it: an old heap may have that much to reuse.
    """
    size = 100_000_000
    code = f"""
import torch
from harness.measures.memory import peak_bytes
def work():
    torch.ones({size} // 4)
torch.ones(1000)
print(peak_bytes(work, "cpu"))
print(peak_bytes(lambda: None, "cpu"))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    written, nothing = map(int, done.stdout.split())
    # The kernel counts pages, each thread's in lots of 64, and torch starts its threads.
    assert 0.98 * size <= written < 1.2 * size
    assert nothing < 0.1 * size


def test_memory_that_was_used_before_counts_again():
    """20 MB in pieces that a heap keeps after they are freed."""
    code = """
from harness.measures.memory import peak_bytes
def work():
    return [bytearray(20_000) for _ in range(1000)]
pieces = work()
pin = bytearray(20_000)  # what is above them: without it the heap would shrink by itself
del pieces
print(peak_bytes(work, "cpu"))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0.9 * 20e6 < int(done.stdout) < 1.2 * 20e6


def test_where_the_system_tells_no_peak(monkeypatch, tmp_path):
    from harness.measures import memory

    monkeypatch.setattr(memory, "_RESET", tmp_path / "missing" / "clear_refs")
    with pytest.raises(Unsupported, match="clear_refs"):
        peak_bytes(lambda: None, "cpu")


# --- fit -------------------------------------------------------------------------------


@pytest.mark.parametrize("bake", [0.0, 1.5])
def test_fit_records_baking_where_it_is_reported(bake):
    class Bakes(Correct):
        def fit(self, material: Material, budget: Budget, generator: Any) -> FitReport:
            super().fit(material, budget, generator)
            return FitReport(data_seconds=100.0, optimise_seconds=200.0, bake_seconds=bake)

    found = values(run("fit", [job("fit", Bakes(), Plaster())])[0])
    assert found["data-seconds"] == 100 and found["optimise-seconds"] == 200
    assert found.get("bake-seconds", 0.0) == bake and ("bake-seconds" in found) == (bake > 0)
    # Shared targets took no time now: a fit alone would make them.
    assert found["fit-seconds"] == 300 + bake


@pytest.mark.parametrize("parts", [[], [1.0], [1.5, 1.5, 1.5, 1.5], [1.0, 1.4, 1.6, 2.0]])
def test_a_fit_is_as_sure_as_its_parts_are_equal(parts):
    class Timed(Correct):
        def fit(self, material: Material, budget: Budget, generator: Any) -> FitReport:
            super().fit(material, budget, generator)
            return FitReport(data_seconds=100.0, optimise_seconds=6.0, part_seconds=parts)

    outcome = run("fit", [job("fit", Timed(), Plaster())])[0]
    found = {record.metric: record for record in outcome.records}
    for metric, total in (("optimise-seconds", 6.0), ("fit-seconds", 106.0)):
        record = found[metric]
        assert record.value == total
        if len(parts) < 2:
            assert math.isnan(record.ci_low) and math.isnan(record.ci_high)
        else:
            below, above = total - record.ci_low, record.ci_high - total
            assert (below == above == 0) == (len(set(parts)) == 1)
            assert below >= 0 and above >= 0
    assert ("part_seconds" in outcome.arrays) == bool(parts)
