"""What a bilinear texture misses, against waves for which it is known."""

import math

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from harness.cli.main import build
from harness.microgeometry.surface import Surface
from harness.training import detail


class Waves:
    """A surface of energy 1 + depth sin(2 pi cycles u) whose camera sees no difference."""

    name = "waves"

    def __init__(self, cycles: float, depth: float):
        self.cycles, self.depth = cycles, depth

    def of(self, u):
        return 1 + self.depth * (2 * math.pi * self.cycles * u[:, :1]).sin().expand(-1, 3)

    def energy(self, u, kernel, wi, samples, seed, depth, device):
        assert wi.square().sum(1).max() < 1
        self.kernel = kernel
        return self.of(u), torch.zeros(len(u), 3)


@pytest.mark.parametrize("texels", (2, 4, 8, 16))
def test_a_wave_loses_what_its_texels_do_not_hold(texels):
    r"""Half a texel to both sides, b sin x has the mean b sin x cos(pi / texels a wave)."""
    waves = Waves(32 / texels, 0.3)
    for found in detail.measure(waves, 32, places=4096):
        lost = 0.3 * (1 - math.cos(math.pi / texels))
        assert found.missed.abs().max() == pytest.approx(lost / 0.7, rel=0.02)
        # More than 5 % of the wave's 1 + 0.3 s.
        s = torch.linspace(-torch.pi, torch.pi, 200_001).sin()
        share = ((lost * s).abs() > 0.05 * (1 + 0.3 * s)).double().mean()
        assert found.share == pytest.approx(float(share), abs=0.04)
        assert found.noise == 0
    assert waves.kernel.unique().item() == pytest.approx(0.5 / 32)


def test_a_flat_surface_misses_noise_alone():
    paint = {"type": "principled", "base_color": {"type": "rgb", "value": [0.5, 0.3, 0.1]}}
    plain = Surface("plain", np.zeros((16, 16)), paint)
    for found in detail.measure(plain, 16, places=64, paths=4096):
        assert found.share == 0 and found.missed.abs().median() < 3 * found.noise + 1e-6


@pytest.mark.slow
def test_the_table_of_detail():
    found = CliRunner().invoke(build("material"), ["material", "detail", "breccia-marble"])
    assert found.exit_code == 0, found.output
    assert "breccia-marble" in found.stdout and "128²" in found.stdout
