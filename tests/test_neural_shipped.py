"""The neural materials that come with the harness: what they are made of and how good they are."""

import pytest
import torch
from typer.testing import CliRunner

from harness.cli.main import build
from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials import registry
from harness.materials.neural import storage
from harness.materials.neural.files import shipped
from harness.measures.levels import surface_of
from harness.microgeometry.walks import surfaces

NAMES = registry.neural_names()


def test_every_description_is_trained():
    assert set(NAMES) == set(surfaces.reliefs())


@pytest.mark.parametrize(
    "name", [NAMES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:])]
)
def test_a_shipped_material(name):
    file = shipped()[name]
    assert file.stat().st_size < 600_000
    record = storage.record(file)
    assert record["name"] == name and registry.describe(name) == record["about"] != ""
    assert record["steps"] > 0 and record["train_seconds"] > 0
    quality, single = record["quality"], record["quality_in_single_precision"]
    trained = record.get("quality_when_trained", quality)
    assert quality["r2"] >= 0.9
    assert quality["energy_within"] >= 0.95
    assert quality["energy_noise"] < 0.015
    assert abs(trained["r2"] - single["r2"]) < 0.005
    assert abs(quality["energy_bias"]) < 0.05
    material = registry.make(name)
    g = torch.Generator().manual_seed(0)
    condition = material.conditions(2000, g)
    f = material.eval(condition, square_to_disk(torch.rand(2000, 2, generator=g)))
    assert torch.isfinite(f).all() and f.min() >= 0 and f.mean() > 1e-3
    assert surface_of(material).name == name


def test_the_table_of_records():
    found = CliRunner().invoke(
        build("material"), ["material", "show", NAMES[0]], env={"COLUMNS": "80"}
    )
    assert found.exit_code == 0 and "steps" in found.stdout
    with pytest.raises(InputError, match="did you mean"):
        CliRunner().invoke(
            build("material"), ["material", "show", NAMES[0] + "x"], catch_exceptions=False
        )
