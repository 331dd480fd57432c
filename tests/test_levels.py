"""The measure of neural materials across levels of detail."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from harness.core.protocol.errors import Unsupported
from harness.materials.neural.architecture import Architecture
from harness.materials.neural.material import NeuralMaterial
from harness.materials.neural.network import NeuralMBTF
from harness.measures import levels
from tests.measuring import run

SMALL = Architecture(resolution=16, offset_resolution=8, width=8, layers=1)


class Flat:
    """A surface that reflects the same everywhere."""

    name, resolution = "flat", 64

    def __init__(self, value: float, noise: float = 0.0):
        self.value, self.noise = value, noise

    def reflectance(self, u, kernel, wi, wo, samples, seed, depth, device, light):
        g = torch.Generator().manual_seed(seed)
        return self.value + self.noise * torch.randn(len(u), 3, generator=g)


def constant(value: float) -> NeuralMaterial:
    """A network that answers ``value`` to everything."""
    net = NeuralMBTF(SMALL)
    with torch.no_grad():
        net.decoder.layers[-1].weight.zero_()
        net.decoder.layers[-1].bias.fill_(value)
    return NeuralMaterial("constant", net, {})


def job(material, generator=None):
    return SimpleNamespace(
        material=material,
        settings={"levels": 2, "views": 8, "size": 16, "samples": 1},
        generator=torch.Generator().manual_seed(0),
    )


def found(monkeypatch, surface, value):
    monkeypatch.setattr(levels, "surface_of", lambda _: surface)
    outcome = run("levels", [job(constant(value))])[0]
    return {r.metric: r for r in outcome.records}, outcome


def test_a_perfect_fit_has_no_error(monkeypatch):
    records, outcome = found(monkeypatch, Flat(0.2), 0.2)
    for level in (0, 1):
        assert records[f"mse-{level}"].value == pytest.approx(0, abs=1e-10)
        assert records[f"ssim-{level}"].value == pytest.approx(1)
    assert np.allclose(outcome.images["truth-0"], outcome.images["neural-0"], atol=1e-5)


def test_the_error_is_that_of_the_pictures(monkeypatch):
    records, outcome = found(monkeypatch, Flat(0.2), 0.3)
    # The first view's light brings pi times its cosine.
    difference = outcome.images["neural-0"] - outcome.images["truth-0"]
    assert np.allclose(outcome.arrays["mse"][0][0], np.square(difference).mean())
    assert records["mse-0"].ci_low < records["mse-0"].value < records["mse-0"].ci_high
    assert records["flip-0"].value > 0.05


def test_noise_of_the_truth_is_no_error_of_the_network(monkeypatch):
    records, _ = found(monkeypatch, Flat(0.2, noise=0.05), 0.2)
    # Left in, it would be half of (0.05 pi cos)^2, about 0.008.
    assert abs(records["mse-0"].value) < 0.001


def test_sizes_are_counted():
    records = levels.sizes(constant(0.1))
    decoder, offset = 12 * 8 + 8 + 8 * 3 + 3, 10 * 8 + 8 + 8 + 1
    assert records["network_parameters"] == decoder + offset
    assert records["texture_numbers"] == 16 * 16 * 8 + 8 * 8 * 8
    assert records["texture_channels"] == 16


def test_a_material_without_a_surface_is_unsupported():
    with pytest.raises(Unsupported, match="no record"):
        levels.surface_of(constant(0.1))
    other = constant(0.1)
    other.record = {"name": "no-such", "description": {}}
    with pytest.raises(Unsupported, match="no description 'no-such'"):
        levels.surface_of(other)
