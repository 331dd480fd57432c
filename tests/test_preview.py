"""Pictures of microgeometry: which queries they ask, and what a constant answer develops to."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from matplotlib.image import imread

from harness.core.protocol.disk import to_direction
from harness.microgeometry.__main__ import main
from harness.microgeometry.preview import (
    develop,
    perspective,
    perspective_shots,
    plane,
    plane_shots,
    sphere,
    sphere_shots,
)
from harness.microgeometry.surface import Surface


def white(u, kernel, wi, wo):
    """A Lambertian of albedo one."""
    return torch.full((len(u), 3), 1 / math.pi)


def striped() -> Surface:
    """Flat; the left half of the tile is white, the right black; its upper quarter grey."""
    picture = np.zeros((16, 16, 1), np.float32)
    picture[:, :8] = 1
    picture[12:] = 0.5  # rows grow with v
    texture = {"type": "bitmap", "array": picture, "raw": True, "filter_type": "nearest"}
    return Surface("striped", np.zeros((16, 16)), {"type": "diffuse", "reflectance": texture})


def test_a_plane_has_u_to_the_right_and_v_upwards():
    image = plane(striped(), 32, wi=(0.3, 0.1), wo=(0.0, 0.0), spp=4)
    assert image.shape == (32, 32, 3)
    expected = torch.zeros(32, 32)
    expected[:, :16], expected[:8] = 1, 0.5
    inside = [4, 12, 20, 27]  # away from the edges, over which footprints reach
    torch.testing.assert_close(
        image[inside][:, inside, 1], expected[inside][:, inside], atol=1e-3, rtol=0
    )


def test_light_falls_on_a_plane_with_its_cosine():
    image = develop(plane_shots(4, wo=(0.6, 0.0)), white)
    torch.testing.assert_close(image, torch.full((4, 4, 3), 0.8))


def test_a_sphere_is_lit_from_its_side():
    """Lambert's cosine over a white sphere, and nothing around it."""
    shots = sphere_shots(33, wo=(-0.5, 0.5), dome=0)
    image = develop(shots, white)[..., 0]
    y, x = np.mgrid[0:33, 0:33]
    p = np.stack([(2 * x + 1) / 33 - 1, 1 - (2 * y + 1) / 33], -1) / 0.96
    z = np.sqrt(np.maximum(1 - (p**2).sum(-1), 0))
    light = to_direction(torch.tensor([-0.5, 0.5])).numpy()
    expected = np.maximum(p @ light[:2] + z * light[2], 0) * ((p**2).sum(-1) < 0.9999)
    np.testing.assert_allclose(image, np.where(expected > 1e-3, expected, image), atol=1e-4)
    assert (image[(p**2).sum(-1) > 1] == 0).all()


def test_frames_of_the_sphere_see_camera_and_light_at_their_angles():
    shots = sphere_shots(20, dome=0)
    towards = to_direction(shots.wi)
    y, x = shots.pixel // 20, shots.pixel % 20
    p = torch.stack([(2 * x + 1) / 20 - 1, 1 - (2 * y + 1) / 20], 1) / 0.96
    torch.testing.assert_close(towards[:, 2], (1 - p.square().sum(1)).sqrt(), rtol=1e-3, atol=1e-3)
    between = (towards * to_direction(shots.wo)).sum(1)
    light = to_direction(torch.tensor([-0.45, 0.5]))[2]
    torch.testing.assert_close(between, light.expand_as(between), rtol=1e-3, atol=1e-3)


def test_the_dome_is_estimated_without_bias():
    """Two estimates of a white plane under the studio: ours, and a mean over the hemisphere."""
    from harness.microgeometry.preview import studio

    shots = plane_shots((20, 20), wi=(0.5, -0.4), spp=400, dome=1.0, seed=3)
    key = plane_shots((20, 20), wi=(0.5, -0.4), spp=1)
    found = (develop(shots, white) - develop(key, white))[..., 0]
    generator = torch.Generator().manual_seed(0)
    radius, turn = torch.rand(2, 400_000, generator=generator)
    disk = radius.sqrt()[:, None] * torch.stack(
        [(6.2831853 * turn).cos(), (6.2831853 * turn).sin()], 1
    )
    expected = studio(to_direction(disk))
    spread = (found.var() / found.numel() + expected.var() / len(expected)).sqrt()
    assert abs(found.mean() - expected.mean()) < 4 * spread


def test_a_perspective_sees_the_plane_shrink_with_distance():
    """Rows further up look further away: larger footprints, flatter directions; sky above."""
    shots = perspective_shots(24, tiles=4, dome=0)
    kernel = torch.zeros(24 * 24).index_put_((shots.pixel,), shots.kernel).view(24, 24)
    rows = kernel[:, 12]
    assert (rows[:-1] >= rows[1:]).all() and rows[0] > 1.3 * rows[-1]
    image = perspective(striped(), 24, spp=1, tiles=4, dome=0)
    assert image.shape == (24, 24, 3) and torch.isfinite(image).all() and image.max() > 0.2


def test_pictures_are_seeded():
    one, two, other = (sphere(striped(), 12, spp=2, seed=s) for s in (1, 1, 2))
    assert torch.equal(one, two) and not torch.equal(one, other)


@pytest.mark.parametrize("shots", [plane_shots(6, dome=1.0, spp=3), sphere_shots(6, spp=3)])
def test_every_shot_is_a_possible_query(shots):
    for w in (shots.wi, shots.wo):
        assert (w.square().sum(1) < 1).all()
    assert (shots.kernel > 0).all() and (shots.weight >= 0).all()


def test_the_commands(tmp_path, capsys):
    small = ["--resolution", "32"]
    picture = tmp_path / "sheet.png"
    for arguments, status in (
        (["sheet", str(picture), "--name", "leather", "--pixels", "12", "--spp", "1", *small], 0),
        (["speed", "leather", "--count", "64", "--repeats", "2", *small], 0),
        (["speed", "lether"], 2),
    ):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert (end.value.code or 0) == status
    said = capsys.readouterr()
    assert imread(picture).shape[:2] == (12, 2 * 3 * 12)
    assert "leather on cpu:" in said.out and "did you mean 'leather'" in said.err
