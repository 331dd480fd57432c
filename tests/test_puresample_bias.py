"""The samplers of shipped materials are unbiased against the materials' own f, in images."""

from __future__ import annotations

import pytest

from harness._methods.cosine import Cosine
from harness._methods.puresample import PureSample
from harness.materials import registry
from harness.mitsuba_runtime import variant
from harness.scenes import registry as scenes
from harness.stats.blocks import Blocks
from harness.stats.ztest import agreement_of_blocks, holm

variant.use("cpu")

from harness.rendering.prepared import prepare  # noqa: E402

SIDE, SPP, TIMES = 16, 128, 4
SCENES = ("quad", "bent-quad", "uniform-sphere", "studio-sphere", "draped-cloth")


def blocks(scene, material, method, spp: int, seed: int) -> Blocks:
    method.bind(material)
    prepared = prepare(scene, material, method, SIDE)
    done = prepared.render(spp, seed)
    return Blocks.of(done.mean, done.variance / done.spp, prepared.mask, SIDE // 2)


@pytest.mark.slow
def test_no_bias_in_twenty_images():
    """Of two materials in five scenes by both samplers, beside f sampled by the cosine."""
    found = []
    for m, name in enumerate(registry.puresample_names()[:2]):
        material = registry.make(name)
        for s, scene in enumerate(map(scenes.make, SCENES)):
            seed = 100 * (10 * m + s)
            expected = blocks(scene, material, Cosine(), TIMES * SPP, seed)
            for k, channel in enumerate(("highest", "mixture")):
                image = blocks(scene, material, PureSample(channel), SPP, seed + 1 + k)
                found.append(agreement_of_blocks([image, expected], SIDE // 2)[0].p_value)
    assert len(found) == 20
    assert holm(found).min() > 1e-3, found
