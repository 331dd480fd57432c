"""A training's end: energies are drawn as said, taught without bias, and come nearer the truth."""

import math
from dataclasses import replace

import pytest
import torch

from harness.core.protocol.disk import cos_theta
from harness.core.protocol.errors import InputError
from harness.materials.neural import storage
from harness.materials.neural.architecture import Architecture
from harness.microgeometry import queries
from harness.training import energy, profiles, quality, recipe
from harness.training.profiles import Profile
from harness.training.training import Data, Training

SMALL = Architecture(
    resolution=8, channels=4, offset_resolution=4, offset_channels=3, width=8, layers=1,
    half_vector=True, cosines=True, output="log1p",
)  # fmt: skip
PROFILE = Profile(SMALL, 1 << 13, 1, 200, 1 << 10, 50, 1 << 11, 3e-2, 1e-2)


class Glow:
    """A Lambertian whose albedo, in three colours, is a wave; energies by paths are noisy."""

    name = "glow"
    resolution = 64

    def identity(self):
        return {"is": "glow"}

    def albedo(self, u):
        wave = 0.4 + 0.2 * (2 * math.pi * u).sin().prod(1, keepdim=True)
        return wave * torch.tensor([1.0, 0.7, 0.4])

    def reflectance(self, u, kernel, wi, wo, samples, seed, depth, device, light):
        return self.albedo(u) / math.pi

    def energy(self, u, kernel, wi, samples, seed, depth, device):
        noise = 1 + 0.5 * torch.randn(len(u), 1, generator=torch.Generator().manual_seed(seed))
        return noise * self.albedo(u), 0 * self.albedo(u)


def trained() -> tuple[Training, Data]:
    training = Training(PROFILE, 0)
    rows = Data(*queries.draw(Glow(), PROFILE.queries, 0, 0.5 / 8, 1))
    training.run(rows, lambda _step, _loss: None)
    return training, rows


def test_conditions_are_where_they_are_said_to_be():
    known = energy.draw(Glow(), 0.06, 1 << 17, 1)
    assert known.wi.square().sum(1).max() < 1 and known.u.min() >= 0 and known.u.max() < 1
    cosine = cos_theta(known.wi)
    for c in (0.2, 0.5, 0.9):  # on the disk, c^2 of the directions are below a cosine of c
        expected = 0.7 * c**2 + 0.3 * c
        assert float((cosine < c).double().mean()) == pytest.approx(expected, abs=0.006)
    # Place, camera and azimuth know nothing of each other.
    columns = torch.cat([known.u, known.wi, cosine[:, None]], 1).T.double()
    assert (torch.corrcoef(columns) - torch.eye(5)).abs().max() < 0.015
    assert float(known.energy.mean()) == pytest.approx(0.4 * 0.7, rel=0.02)


def test_the_gradient_is_that_of_the_squared_error_and_holds_no_variance():
    """Against the energy integrated finely; the square of one estimate's error is another's."""
    training, _ = trained()
    network, weights = training.network, [*training.network.decoder.parameters()]
    n = 32
    g = torch.Generator().manual_seed(3)
    u = torch.rand(n, 2, generator=g)
    wi = 0.9 * (2 * torch.rand(n, 2, generator=g) - 1) / 2**0.5
    known = energy.Known(u, wi, Glow().albedo(u) * 1.3)

    def gradient(value):
        return torch.cat([x.flatten() for x in torch.autograd.grad(value, weights)])

    drawn = torch.stack([gradient(energy.loss(network, known, seed)) for seed in range(100)])
    wo = queries.stratified(n, 64, 9)
    rows = [
        x[:, None].expand(-1, wo.shape[1], -1).flatten(0, 1) for x in (network.features(u, wi), wi)
    ]
    whole = math.pi * network.reflectance(*rows, wo.flatten(0, 1)).view(n, -1, 3).mean(1)
    scale = (whole.detach() + 0.05).square()
    exact = gradient(((whole - known.energy).square() / scale).mean())
    apart = (drawn.mean(0) - exact).norm() / exact.norm()
    noise = (drawn.std(0) / 100**0.5).norm() / exact.norm()
    assert apart < 0.01 + 3 * noise and noise < 0.05


@pytest.mark.slow
def test_energies_come_nearer_the_truth():
    training, rows = trained()
    with torch.no_grad():  # all of a fifth too bright, as no reflectance is
        training.network.decoder.layers[-1].bias += 0.02

    def error() -> tuple[float, float]:
        asked = energy.draw(Glow(), 0.06, 512, 77)
        wo = queries.stratified(512, 32, 5)
        f = training.network.features(asked.u, asked.wi)
        with torch.no_grad():
            rows = [x[:, None].expand(-1, 1024, -1).flatten(0, 1) for x in (f, asked.wi)]
            found = math.pi * training.network.reflectance(*rows, wo.flatten(0, 1)).view(512, -1, 3)
        relative = found.mean(1) / Glow().albedo(asked.u) - 1
        return float(relative.mean()), float(relative.square().mean().sqrt())

    before = error()
    known = energy.draw(Glow(), 0.06, 1 << 15, 5)
    offset = training.network.offset.texture.clone()
    seconds = energy.teach(training, known, rows, 60, 6)
    after = error()
    assert before[0] > 0.03 and abs(after[0]) < 0.3 * before[0] and after[1] < before[1]
    assert torch.equal(offset, training.network.offset.texture) and seconds > 0


def test_one_seed_one_ending():
    ends = []
    for _ in range(2):
        training, rows = trained()
        energy.teach(training, energy.draw(Glow(), 0.06, 1 << 12, 5), rows, 5, 6)
        ends.append(training.network.state_dict())
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])


def test_what_can_be_taught_energies():
    assert energy.able(Glow(), Training(PROFILE, 0).network)
    pyramid = replace(PROFILE, architecture=replace(SMALL, pyramid=True))
    assert not energy.able(Glow(), Training(pyramid, 0).network)
    assert not energy.able(object(), Training(PROFILE, 0).network)


@pytest.fixture
def glow(monkeypatch):
    monkeypatch.setattr(recipe.descriptions, "load", lambda _: Glow())
    monkeypatch.setattr(recipe.descriptions, "find", lambda name: name)
    monkeypatch.setattr(recipe, "read", lambda _: None)
    small = replace(PROFILE, steps=20, final_steps=5)
    monkeypatch.setitem(profiles.PROFILES, "plain", small)
    monkeypatch.setitem(profiles.PROFILES, "taught", replace(small, energy_steps=4))
    pyramid = replace(SMALL, pyramid=True)
    monkeypatch.setitem(profiles.PROFILES, "pyramid", replace(small, architecture=pyramid))
    draw = quality.Held.draw
    monkeypatch.setattr(
        recipe.Held, "draw", lambda s, seed, k, device: draw(s, seed, k, 512, 1, 16, 16, 4, device)
    )


def test_a_profile_says_whether_energies_end_a_training(tmp_path, glow):
    for name in ("plain", "taught"):
        recipe.train("glow", tmp_path / f"{name}.safetensors", name)
    plain, taught = (storage.load(tmp_path / f"{n}.safetensors") for n in ("plain", "taught"))
    assert not torch.equal(plain.texture, taught.texture)
    assert torch.equal(plain.offset.texture, taught.offset.texture)


def test_a_stored_material_is_refined_and_says_so(tmp_path, glow):
    file = tmp_path / "m.safetensors"
    before, hashed = recipe.train("glow", file, "plain"), storage.reflectance_hash(file)
    recipe.measure(file)
    found = recipe.refine(file, 3)
    assert "quality_when_trained" not in found and "measured" not in found
    assert found == storage.record(file) and found["refined"]["steps"] == 3
    assert found["profile"] == before["profile"] and found["seed"] == before["seed"]
    assert found["quality"] != before["quality"] and storage.reflectance_hash(file) != hashed


def test_a_pyramid_is_not_refined(tmp_path, glow):
    recipe.train("glow", tmp_path / "m.safetensors", "pyramid")
    with pytest.raises(InputError, match="one resolution"):
        recipe.refine(tmp_path / "m.safetensors")
