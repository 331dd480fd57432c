"""Methods without a network render as part of Mitsuba's own kernel; a sample's time in parts."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
import torch

from harness.core.compiled import library
from harness.core.protocol.method import Budget
from harness.mitsuba_runtime import variant

mi = variant.use("cpu")

from harness.bench import profile, ratios  # noqa: E402  a variant has to be set first
from harness.bench.interleaved import interleaved  # noqa: E402
from harness.rendering import meter  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402
from harness.scenes import registry as scenes  # noqa: E402
from tests.render_subjects import SCENE, UniformDisk, White, ready, rough  # noqa: E402


@pytest.mark.parametrize("method", ["cosine", "native"])
def test_the_image_is_that_of_evaluated_mode(method):
    """Light sampled too, so that values and densities are asked for."""
    material, scene = rough(), scenes.make("studio-sphere")
    prepared = prepare(scene, material, ready(method, material), 16, "mis")
    assert prepared.symbolic
    one, many = prepared.render(16, 3), replace(prepared, symbolic=False).render(16, 3)
    np.testing.assert_allclose(one.rgb, many.rgb, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.variance, many.variance, rtol=1e-4, atol=1e-6)


def test_what_has_a_network_or_runs_in_torch_is_evaluated():
    material = rough()
    assert not prepare(SCENE, material, ready("two-lobe", material), 8).symbolic
    assert not prepare(SCENE, material, ready(UniformDisk(), material), 8).symbolic
    white = White()  # a material in torch
    assert not prepare(SCENE, white, ready("cosine", white), 8).symbolic


def test_a_meter_still_counts():
    material = rough()
    prepared = prepare(SCENE, material, ready("cosine", material), 8)
    with meter.metered(prepared.bsdf) as found:
        prepared.render(4, 0)
    assert found.counts["samples"] > 0 and found.parts["sample"].seconds > 0


def test_a_network_that_is_alive_is_not_compiled_into_the_kernel():
    """It would be, with all its layers, for a scene that it is not in."""
    material = rough()
    other = prepare(SCENE, material, ready("two-lobe", material), 8)
    before = prepare(SCENE, material, ready("cosine", material), 8)
    calls = []
    bare = other.bsdf._draw_bare
    other.bsdf._draw_bare = lambda *arguments: calls.append(1) or bare(*arguments)
    assert np.isfinite(before.render(4, 0).rgb).all()
    assert not calls
    assert np.isfinite(other.render(4, 0).rgb).all()
    assert calls


@pytest.mark.parametrize("name", ["cosine", "two-lobe"])
def test_parts_of_a_sample(name):
    """What is there and what is not; how long it takes decides nothing."""
    material = rough()
    method = ready(name, material)
    if name == "two-lobe":
        budget = Budget(steps=2, pool=16, conditions=8, directions=8)
        method.fit(material, budget, torch.Generator().manual_seed(0))
    generator = torch.Generator().manual_seed(1)
    condition = material.conditions(500, generator, "cpu")
    parts = profile.measure(method, condition, torch.rand(500, 3, generator=generator), 3)
    assert all(math.isfinite(v) for v in astuple(parts))
    assert parts.whole > 0 and parts.kernels > 0 and parts.spline == 0
    compiled = name == "two-lobe" and not library.why_not()
    assert (parts.network > 0) is compiled
    shown = parts.to_columns + parts.to_rows + parts.network + parts.kernels + parts.fixed
    assert parts.rest == pytest.approx(parts.whole - shown)


@pytest.mark.slow
def test_ratios_are_of_the_same_samples():
    """By compiled kernels, by Dr.Jit and by PyTorch; how long each takes decides nothing."""
    material = rough()
    method = ready("flow-matching", material)
    generator = torch.Generator().manual_seed(1)
    condition = material.conditions(200, generator, "cpu")
    found = ratios.works(method, condition, torch.rand(200, 3, generator=generator))
    ways = {"Dr.Jit", "PyTorch"} | ({"compiled"} if not library.why_not() else set())
    assert list(found) == ["sample", "pdf"] and all(set(w) == ways for w in found.values())
    for work in found.values():
        results = [way() for way in work.values()]
        for other in results[1:]:
            for a, b in zip(results[0], other, strict=True):
                torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)
    seconds = interleaved(found["pdf"], 2)
    assert set(seconds) == ways and all(len(s) == 2 and (s > 0).all() for s in seconds.values())
