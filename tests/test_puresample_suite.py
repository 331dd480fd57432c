"""The commands in suites/puresample.yaml make the files that the suite looks for."""

from __future__ import annotations

import shlex

import pytest
import torch

from harness.core.paths import SUITES
from harness.core.yamlfile import read_yaml
from harness.training.changes import changed
from harness.training.puresample import data, sources
from harness.training.puresample.profiles import profile
from harness.training.puresample.recipe import checked

ENTRIES = [
    entry
    for entry in read_yaml(SUITES / "puresample.yaml", "a suite in YAML")["materials"]
    if isinstance(entry, dict)
]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["name"])
def test_a_command_is_one_of_a_training(entry: dict):
    words = shlex.split(entry["made_by"])
    assert words[:3] == ["harness", "material", "train"]
    options = dict(zip(words[4::2], words[5::2], strict=True))
    assert options.pop("--out") == entry["file"]
    assert options.pop("--kind") == entry["type"] == "puresample"
    chosen = profile(options.pop("--profile", "quick"))
    checked(changed(chosen, [options.pop("--set")] if "--set" in options else []))
    assert not options


@pytest.mark.parametrize("name", sorted({entry["made_by"].split()[3] for entry in ENTRIES}))
def test_particles_walk_on_what_is_to_be_learned(name: str):
    source, n = sources.load(name), 512
    random = torch.Generator().manual_seed(0)
    u = torch.rand(n, 2, generator=random)
    wi = torch.tensor([0.4, 0.2]).expand(n, 2).contiguous()
    exits = source.walk(u, wi, torch.arange(n) % 3, seed=1)
    assert source.name == name and source.about
    data.check(source, exits.counts)  # enough of them leave, by weights of at most one
