"""NeuSample's two baselines are one class: they differ in where the lobe's mean comes from."""

from __future__ import annotations

import pytest
import torch

from harness.core import registry
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import Budget
from tests.materials import MATERIALS

BUDGET = Budget(steps=10, conditions=32, directions=16, resolution=16, pool=64)


def fitted(name: str, **params: str):
    method = registry.make(name, **params)
    method.fit(MATERIALS["tilted"](), BUDGET, torch.Generator().manual_seed(0))
    return method


def test_both_names_are_known_and_one_file_has_them():
    found = [registry.find(name) for name in ("improved-baseline", "fan-baseline")]
    assert {item.file.name for item in found} == {"improved_baseline.py"}
    assert {"improved-baseline", "fan-baseline"} <= set(registry.names())
    assert len({registry.describe(item.name) for item in found}) == 2


def test_the_switch_gives_what_the_name_gives():
    ours, theirs = fitted("improved-baseline", mean="mirror"), fitted("fan-baseline")
    for key, value in theirs.state_dict().items():
        assert torch.equal(value, ours.state_dict()[key]), key
    generator = torch.Generator().manual_seed(1)
    condition = MATERIALS["tilted"]().conditions(64, generator)
    u = torch.rand(64, 3, generator=generator)
    for a, b in zip(ours.sample(condition, u), theirs.sample(condition, u), strict=True):
        assert torch.equal(a, b)


def test_the_mean_is_the_mirror_direction_or_predicted():
    condition = MATERIALS["tilted"]().conditions(64, torch.Generator().manual_seed(1))
    for name, mirrored in (("fan-baseline", True), ("improved-baseline", False)):
        mean = fitted(name).lobes(condition).mean[..., 0, :]
        assert torch.equal(mean, -condition[:, -2:]) == mirrored


def test_an_unknown_mean_is_refused():
    with pytest.raises(InputError, match="mean: expected predicted or mirror, got 'miror'"):
        registry.make("improved-baseline", mean="miror")
    with pytest.raises(InputError, match="unknown parameter 'mean'"):
        registry.make("fan-baseline", mean="mirror")
