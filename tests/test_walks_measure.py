"""The measure of materials learned from walks beside the walks."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import Unsupported
from harness.core.record import Raw
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.material import PureSampleMaterial
from harness.materials.puresample.network import PureSample
from harness.measures import walks
from harness.microgeometry.walks.kernel import Counts, Exits
from tests.materials import Plain
from tests.measuring import run

SETTINGS = {"angles": 3, "azimuths": 2, "walks": 1 << 15, "pairs": 500, "places": 2}


class Matt:
    """Exits uniform on the disk, with that share of survivors in each channel."""

    def __init__(self, *share: float):
        self.share = torch.tensor(share)

    def walk(self, u, wi, channel, seed, device="cpu"):
        random = torch.rand(len(wi), 3, generator=torch.Generator().manual_seed(seed))
        left = random[:, 2] < self.share[channel.long()]
        wo = torch.where(left[:, None], square_to_disk(random[:, :2]), 0)
        return Exits(wo, left, torch.ones(len(wi), dtype=torch.int32), Counts(walks=len(wi)))


def matt(*albedo: float, **sizes) -> PureSampleMaterial:
    """A material that draws the uniform disk and has those albedos from everywhere."""
    net = PureSample(Architecture(base="normal", width=8, layers=1, albedo_width=8, **sizes))
    last = net.albedo_net.layers[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.logit(torch.tensor(albedo)))
    return PureSampleMaterial("matt", net, {})


def found(monkeypatch, source, material) -> dict:
    monkeypatch.setattr(walks, "source_of", lambda _: source)
    job = SimpleNamespace(
        material=material, settings=SETTINGS, seed=1, generator=torch.Generator().manual_seed(0)
    )
    outcome = run("walks", [job])[0]
    return {r.metric: r for r in outcome.records}


def test_a_perfect_fit_has_no_error(monkeypatch):
    records = found(monkeypatch, Matt(0.5, 0.6, 0.8), matt(0.5, 0.6, 0.8))
    for i in range(3):
        ratio = records[f"albedo-ratio-{i}"]
        assert ratio.ci_low - 0.002 < 1 < ratio.ci_high + 0.002
        assert ratio.ci_high - ratio.ci_low < 0.01
    assert records["albedo-within"].value == 1
    assert abs(records["shape-error"].value) < 1e-3
    assert records["reciprocity-error"].value < 1e-4


def test_errors_are_seen(monkeypatch):
    """A tenth too bright: in the energy, and as its square in f."""
    records = found(monkeypatch, Matt(0.5, 0.6, 0.8), matt(0.55, 0.66, 0.88))
    ratio = records["albedo-ratio-1"]
    assert ratio.value == pytest.approx(1.1, abs=0.01) and ratio.ci_low > 1.08
    assert records["albedo-within"].value == 0
    assert records["shape-error"].value == pytest.approx(0.01, rel=0.25)


def test_the_walks_noise_is_no_error():
    """Draws of the same particles: the mean shape error is zero, however few they are."""
    from harness.analysis.records.walks import _shape_errors

    p = np.array([0.2, 0.1, 0.3, 0.05])
    n, random = 200, np.random.default_rng(1)
    counts = random.multinomial(n, [*p, 1 - p.sum()], size=4000)[:, :4]
    errors = _shape_errors(counts.astype(float), np.broadcast_to(p, (4000, 4)), n)
    assert abs(errors.mean()) < 3 * errors.std() / np.sqrt(4000)
    # What is not taken off would be as large as this.
    naive = np.square(counts / n - p).sum(1) / np.square(p).sum()
    assert naive.mean() > 10 * abs(errors.mean())


def test_asymmetry_is_the_reciprocity_error():
    from harness.analysis.records import walks as records

    f = np.full((100, 2, 3), 1.0)
    f[:, 1] = 3.0
    arrays = {
        "walks": np.array(100), "left": np.full((1, 1, 3), 50), "pairs": f,
        "count": np.full((1, 1, 3, 4), 12), "mass": np.full((1, 1, 3, 4), 0.12),
        "learned": np.full((1, 1, 3), 0.48),
        "size_bytes": np.array(7),
    }  # fmt: skip
    found = {r.metric: r.value for r in records.numbers(Raw(arrays, {}, {})).records}
    assert found["reciprocity-error"] == pytest.approx(1.0) and found["size-bytes"] == 7
    assert found["albedo-ratio-0"] == pytest.approx(0.48 / 0.5)


def test_other_materials_have_no_walks():
    with pytest.raises(Unsupported, match="no record of walks or"):
        walks.source_of(Plain())
    lost = matt(0.5, 0.5, 0.5)
    lost.record = {"name": "no-such", "description": {}}
    with pytest.raises(Unsupported, match="no such description: no-such"):
        walks.source_of(lost)
    lost.record = {"name": "clay-beads", "description": {}}
    with pytest.raises(Unsupported, match="has changed"):
        walks.source_of(lost)


def test_a_material_learned_from_evaluations_is_measured_beside_walks_too():
    """A shipped one beside particles on its relief: of about their albedo, and every record."""
    from harness.materials import registry

    material = registry.make("leather")
    settings = SETTINGS | {"angles": 1, "azimuths": 1, "walks": 1 << 13, "places": 4}
    job = SimpleNamespace(
        material=material, settings=settings, seed=1, generator=torch.Generator().manual_seed(0)
    )
    outcome = run("walks", [job])[0]
    records = {r.metric: r.value for r in outcome.records}
    assert records["albedo-ratio-0"] == pytest.approx(1, abs=0.3)
    mass = outcome.arrays["mass"].astype(float)
    assert outcome.arrays["learned"] == pytest.approx(mass.sum(-1), rel=1e-5)
    assert 5e4 < records["size-bytes"] < 2e6
