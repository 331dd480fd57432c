"""Trainings from walks that are interrupted, and families under a normal map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from harness.core.protocol.disk import cos_theta, square_to_disk
from harness.core.protocol.errors import InputError
from harness.microgeometry.descriptions import DESCRIPTIONS
from harness.training.puresample import albedo, data, recipe, sources
from harness.training.puresample.descent import UnderWay
from harness.training.puresample.normal_mapped import turned
from tests.test_puresample_training import BRASS, TINY, Matt, rng

PROFILE = replace(
    TINY, walks=1 << 12, matching_steps=6, likelihood_steps=6, albedo_steps=6, directions=64
)


class Interrupt:
    """Notifies until ``count`` messages have come, then as Ctrl-C does."""

    def __init__(self, count: int):
        self.left = count

    def __call__(self, text: str, share: float) -> None:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("count", [3, 6, 8, 12, 15])
def test_an_interrupted_training_ends_where_a_whole_one_does(tmp_path, count):
    """In the middle of each phase and at the end of two, to the bit."""
    source = Matt(0.3, 0.5, 0.7)
    walked = data.draw(source, PROFILE.walks, 1)
    survival = albedo.draw(source, PROFILE.directions, PROFILE.group, 2)
    whole = recipe.fitted(PROFILE, walked, survival, 0)
    file = tmp_path / "m.train"

    def part(notify=lambda *_: None, resume=True):
        under_way = UnderWay(file, {"seed": 0})
        return recipe.fitted(PROFILE, walked, survival, 0, "cpu", notify, under_way, resume)

    with pytest.raises(KeyboardInterrupt):
        part(Interrupt(count), resume=False)
    assert file.is_file()
    ended = part()
    for name, value in whole.state_dict().items():
        assert torch.equal(value, ended.state_dict()[name]), name


def test_what_cannot_be_resumed_is_said(tmp_path):
    file = tmp_path / "m.train"
    network = torch.nn.Linear(1, 1)
    with pytest.raises(InputError, match="there is no"):
        UnderWay(file, {}).load(network)
    file.write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be resumed"):
        UnderWay(file, {}).load(network)
    optimiser = torch.optim.Adam(network.parameters())
    UnderWay(file, {"seed": 1}).save("matching", 1, network, optimiser, rng(0))
    with pytest.raises(InputError, match="another training .its seed differs"):
        UnderWay(file, {"seed": 2}).load(network)
    with pytest.raises(InputError, match="--resume: there is no"):
        recipe.train("clay-beads", tmp_path / "n.safetensors", resume=True)


# --- normal maps -----------------------------------------------------------------------


def test_the_least_rotation_takes_the_pole_to_the_normal_and_back():
    n = torch.nn.functional.normalize(torch.randn(200, 3, generator=rng(1)), dim=1)
    n = torch.cat([n[:, :2], n[:, 2:].abs()], 1)
    pole = torch.tensor([0.0, 0.0, 1.0]).expand(200, 3)
    torch.testing.assert_close(turned(pole, n), n)
    v = torch.nn.functional.normalize(torch.randn(200, 3, generator=rng(2)), dim=1)
    moved = turned(v, n)
    torch.testing.assert_close(moved.norm(dim=1), torch.ones(200))
    torch.testing.assert_close(turned(moved, n, back=True), v)
    # Least: what is perpendicular to both stays.
    axis = torch.nn.functional.normalize(torch.linalg.cross(pole, n), dim=1)
    torch.testing.assert_close(turned(axis, n), axis)


def mapped(depth: float):
    described = {"family": "ggx-conductor", "fix": BRASS, "type": "family"}
    words = {"fields": {"dents": "noise(4, seed=1)"}, "micro": {"field": "dents", "depth": depth}}
    return sources.of_record({"name": "dented", "description": {**described, **words}})


def test_a_flat_normal_map_is_the_family_itself_and_a_dented_one_follows_its_normals():
    n = 1 << 14
    u = torch.rand(n, 2, generator=rng(3))
    wi = 0.5 * square_to_disk(torch.rand(n, 2, generator=rng(4)))
    channel = torch.arange(n) % 3
    family = mapped(0.0).family
    plain, flat = family.walk(u, wi, channel, 5), mapped(0.0).walk(u, wi, channel, 5)
    assert torch.equal(plain.left, flat.left)
    torch.testing.assert_close(plain.wo, flat.wo, atol=1e-6, rtol=0)
    dented = mapped(0.05)
    normals = dented.normals.numpy()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)
    found = dented.walk(u, wi, channel, 5)
    assert found.counts.left == int(found.left.sum()) < plain.counts.left
    # What came from above in the turned frame is the family's walk there, turned.
    at = torch.tensor([[0.3, 0.6]]).expand(n, 2)
    normal = dented._normal(at[:1])
    local = turned(torch.cat([wi, cos_theta(wi)[:, None]], 1), normal.expand(n, 3), back=True)
    assert (local[:, 2] > 0).all()
    there, here = dented.walk(at, wi, channel, 6), family.walk(at, local[:, :2], channel, 6)
    both = torch.cat([here.wo, cos_theta(here.wo)[:, None]], 1)
    expected = turned(both, normal.expand(n, 3))
    left = here.left & (expected[:, 2] > 0)
    assert torch.equal(there.left, left)
    torch.testing.assert_close(there.wo[left], expected[left, :2])


WALKS = sorted((DESCRIPTIONS / "walks").glob("*.yaml"))
"""Those of layers compile for ten seconds each."""


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(
            file, id=file.stem, marks=[pytest.mark.slow] * ("layered" in file.read_text("utf-8"))
        )
        for file in WALKS
    ],
)
def test_the_described_walks_leave(file):
    source = sources.load(file)
    assert source.name == file.stem and source.about
    n = 1 << 12
    wi = square_to_disk(torch.rand(n, 2, generator=rng(6)))
    u = torch.rand(n, 2, generator=rng(7))
    found = source.walk(u, wi, torch.arange(n) % 3, 8)
    data.check(source, found.counts)
    assert 0.1 < found.counts.left / n < 0.99
    again = sources.of_record({"name": file.stem, "description": recipe_identity(source)})
    assert torch.equal(again.walk(u, wi, torch.arange(n) % 3, 8).wo, found.wo)


def recipe_identity(source) -> dict:
    """As a record has it."""
    import json

    return json.loads(json.dumps(source.identity()))


def test_a_map_without_normals_is_refused():
    described = {"family": "ggx-conductor", "fix": BRASS, "type": "family"}
    with pytest.raises(InputError, match="expected a field and its depth"):
        sources.of_record({"name": "m", "description": {**described, "fields": {"a": "u()"}}})
    bad = {**described, "micro": {"field": "b", "depth": 1}}
    with pytest.raises(InputError, match="'b'|unknown"):
        sources.of_record({"name": "m", "description": bad})
