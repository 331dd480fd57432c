"""The materials learned from walks that come with the harness."""

import json

import pytest
import torch

from harness.materials import registry
from harness.materials.puresample import storage
from harness.materials.puresample.files import shipped
from harness.microgeometry.walks import surfaces
from harness.mitsuba_runtime import variant
from harness.training.puresample import sources

variant.use("cpu")

NAMES = registry.puresample_names()
NARROW = ("stud-grid", "scattered-studs")
"""Highlights narrower than the cells that a KL is counted in, and not learned well."""
WORST = {"bronze-grains": 0.05, "clay-beads": 0.05}
"""What the worst direction's KL stays below, where that is less than 0.25."""


def test_the_eight_of_figure_5_are_there_and_six_are_learned_well():
    eight = surfaces.names()
    assert len(eight) == 8 and set(eight) <= set(NAMES)
    good = [n for n in eight if storage.record(shipped()[n])["quality"]["kl"] < 0.05]
    assert set(eight) - set(good) == set(NARROW)


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_material(name):
    """What its record says of it, and its albedo beside walks that were not drawn before."""
    file = shipped()[name]
    assert file.stat().st_size < 2_000_000
    record = storage.record(file)
    assert record["name"] == name and registry.describe(name) == record["about"] != ""
    source = sources.load(name)
    assert record["description"] == json.loads(json.dumps(source.identity()))
    quality = record["quality"]
    assert (quality["kl_worst"] < WORST.get(name, 0.25)) != (name in NARROW)
    assert quality["albedo_within"] > 0.95
    assert abs(quality["albedo_bias"]) < 0.005
    material, n = registry.make(name), 1 << 15
    for k, wi in enumerate([(0.0, 0.0), (0.5, 0.2), (-0.3, 0.7)]):
        row = torch.tensor(wi)
        u = torch.rand(n, 2, generator=torch.Generator().manual_seed(k))
        found = source.walk(u, row.expand(n, 2).contiguous(), torch.full((n,), k), 1000 + k)
        share = found.counts.left / n
        error = (share * (1 - share) / n) ** 0.5
        learned = float(material.albedo(row[None])[0, k])
        assert abs(learned - share) < 4 * error + 0.03 * share
