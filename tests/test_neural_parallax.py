"""The offset is taught where rays hit: by rays that are right, and so that it learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import cos_theta
from harness.materials.neural.network import NeuralMBTF
from harness.microgeometry.queries import rays
from harness.microgeometry.surface import Surface
from harness.training import parallax
from harness.training.training import Data, Training
from tests.test_neural_training import TINY, Wavy, data, quiet

GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
R = 64


def wave(x: torch.Tensor, depth: float) -> torch.Tensor:
    return depth * torch.cos(4 * torch.pi * x[..., 0])


def waves(depth: float) -> Surface:
    x = (np.arange(R) + 0.5) / R
    return Surface("waves", np.tile(depth * np.cos(4 * np.pi * x), (R, 1)), GREY)


def test_rays_end_on_the_surface_and_meet_nothing_before() -> None:
    """At (u, 0) + z (tan, 1) on the wave; and it is below the ray all the way up from there."""
    depth = 0.04
    u, wi, z = rays(waves(depth), 4000, seed=1)
    tangent = wi / cos_theta(wi)[:, None]
    grazing = cos_theta(wi) < 0.02  # where the facets of the mesh throw shadows of their own
    at = wave(u + z[:, None] * tangent, depth)
    # Facets lie below the crests by h^2 / 8 of the curvature.
    facet = depth * (4 * np.pi / R) ** 2 / 8
    off = (z - at).abs()
    assert float(off[~grazing].quantile(0.999)) < 2 * facet
    above = z[:, None] + torch.linspace(0, 1, 200) * (depth - z)[:, None]
    path = u[:, None] + above[..., None] * tangent[:, None]
    assert (wave(path, depth) - above)[~grazing].max() < 3 * facet


def test_a_flat_surface_has_no_heights_to_teach() -> None:
    flat = Surface("flat", np.zeros((16, 16)), GREY)
    assert torch.equal(rays(flat, 100, seed=0)[2], torch.zeros(100))
    assert not parallax.known(flat) and parallax.known(waves(0.01))
    assert not parallax.known(Wavy())  # a surface that cannot be traced


def test_the_offset_learns_where_rays_hit() -> None:
    torch.manual_seed(0)
    network = NeuralMBTF(TINY.architecture)
    surface = waves(0.04)
    u, wi, z = rays(surface, 4000, seed=9)

    def off() -> float:
        with torch.no_grad():
            return float(parallax.misses(network.offset, u, wi, z).norm(dim=1).median())

    before, texture = off(), network.texture.clone()
    parallax.teach(network.offset, surface, steps=400, seed=0, rays=1 << 18)
    assert before > 0.15 and off() < 0.3 * before
    assert torch.equal(network.texture, texture)


@pytest.mark.parametrize("taught", [True, False])
def test_a_taught_offset_stands_still_while_textures_are_blurred(taught: bool) -> None:
    profile = replace(TINY, steps=20, final_steps=5)
    training = Training(profile, 0, taught=taught)
    start = training.network.offset.texture.clone()
    rows: Data = data(Wavy(0.1), profile)
    training.run(rows, quiet, until=20)
    assert torch.equal(training.network.offset.texture, start) == taught
    middle = training.network.offset.texture.clone()
    training.run(rows, quiet)
    assert not torch.equal(training.network.offset.texture, middle)
