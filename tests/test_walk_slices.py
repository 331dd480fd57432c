"""Where light goes at a few angles, beside walks."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from harness.analysis.records.walk_slices import divergence
from harness.materials.puresample import files, storage
from harness.training.puresample import sources
from tests.measuring import run
from tests.test_walks_measure import Matt, matt

SETTINGS = {"angles": 2, "walks": 1 << 17, "places": 2, "side": 1}


def found(monkeypatch, source, material):
    from harness.measures import walk_slices

    monkeypatch.setattr(walk_slices, "source_of", lambda _: source)
    job = SimpleNamespace(
        material=material, settings=SETTINGS, seed=1, generator=torch.Generator().manual_seed(0)
    )
    outcome = run("walk-slices", [job])[0]
    return outcome.arrays, {r.metric: r.value for r in outcome.records}


def test_the_divergence_is_that_of_the_learned_density(monkeypatch):
    """A material whose density is another than the uniform one, at which the counts are."""
    material = matt(0.5, 0.6, 0.7)
    arrays, records = found(monkeypatch, Matt(0.5, 0.6, 0.7), material)
    masses = arrays["mass"].astype(float)
    q = masses / masses.sum(-1, keepdims=True)
    p = 1 / 48**2
    expected = (p * np.log(p / q)).sum(-1).mean(-1)
    for i in range(2):
        assert records[f"kl-{i}"] == pytest.approx(expected[i], abs=2e-3)
        assert records[f"albedo-ratio-{i}"] == pytest.approx(1, abs=0.01)
    assert np.linalg.norm(arrays["wi"], axis=1) == pytest.approx([0, 0.95], abs=1e-6)
    # The picture's pixels are cells of the disk, all of them, and what lies off it.
    assert set(np.unique(arrays["raster"])) == set(range(-1, 48**2))
    assert "latent" not in arrays


def test_a_textured_material_shows_its_texture(monkeypatch):
    material = matt(0.5, 0.5, 0.5, resolution=4, channels=2)
    arrays, _ = found(monkeypatch, Matt(0.5, 0.5, 0.5), material)
    assert arrays["latent"].shape == (96, 96, 3)


def test_counts_of_the_density_itself_diverge_by_nothing():
    random = np.random.default_rng(1)
    p = random.dirichlet(np.ones(200))
    found = [divergence(random.multinomial(20_000, p).astype(float), p) for _ in range(300)]
    assert np.mean(found) == pytest.approx(0, abs=4 * np.std(found) / np.sqrt(300))
    assert divergence(np.array([3.0, 1.0]), np.array([1.0, 0.0])) == np.inf


def test_a_record_is_enough_to_walk_again():
    """A surface or family is made of what a training recorded, without its file."""
    record = storage.record(files.shipped()["bronze-grains"])
    made = sources.of_record({**record, "name": "renamed"})
    assert made.name == "renamed"
    u = torch.rand(1000, 2, generator=torch.Generator().manual_seed(1))
    wi, channel = 0.5 * u, torch.zeros(1000)
    same = sources.load("bronze-grains").walk(u, wi, channel, 3)
    assert torch.equal(made.walk(u, wi, channel, 3).wo, same.wo)
    fix = {"alpha_x": 0.5, "alpha_y": 0.2, "r0_r": 0.9, "r0_g": 0.7, "r0_b": 0.3}
    described = {"type": "family", "family": "ggx-conductor", "fix": fix}
    assert sources.of_record({"name": "brass", "description": described}).name == "brass"


def test_the_figure_shows_a_pair_per_angle_and_a_texture(monkeypatch, tmp_path):
    """Rows of two materials, one with a texture; cells that reflect alike are shown alike."""
    from PIL import Image

    from harness.report.figures.canvas import Canvas
    from harness.report.figures.walk_slices import _on_disk, walk_slices

    raw = {}
    for name, sizes in (("plain", {}), ("varied", {"resolution": 4, "channels": 2})):
        raw[name], _ = found(monkeypatch, Matt(0.5, 0.5, 0.5), matt(0.5, 0.5, 0.5, **sizes))
    results = SimpleNamespace(
        materials=["plain", "varied", "missing"],
        methods=[SimpleNamespace(label="m")],
        trials=lambda measure, material: [material] if material in raw else [],
        arrays=lambda trial: raw[trial],
        number=lambda *at: "no number",
    )
    drawn = walk_slices(results, Canvas(tmp_path))[0]
    width, height = Image.open(drawn.png).size
    assert width > height > 300
    cells = np.arange(48**2)[:, None] * np.ones(3)
    image = _on_disk(cells, raw["plain"]["raster"])
    assert image.shape == (120, 120, 3) and (image[0, 0] == 1).all()
    results.trials = lambda measure, material: []
    assert "no trial" in walk_slices(results, Canvas(tmp_path))
