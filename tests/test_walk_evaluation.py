"""f of walked surfaces by paths towards the light, beside walks, which never look for one."""

from __future__ import annotations

import math
import re
from functools import partial

import numpy as np
import pytest
import torch

from harness.bench import evaluations
from harness.core.protocol.disk import disk_to_square, square_to_disk
from harness.core.protocol.errors import InputError
from harness.materials.puresample import storage
from harness.materials.puresample.architecture import Architecture
from harness.materials.puresample.network import PureSample
from harness.microgeometry.walks import surfaces
from harness.microgeometry.walks.description import parse
from harness.microgeometry.walks.evaluation import evaluate
from harness.microgeometry.walks.kernel import Counts
from harness.training.puresample.albedo import Survival
from harness.training.puresample.quality import CELLS as COMPARED
from harness.training.puresample.quality import Conditions, Held
from tests.walks import rng

N, CELLS = 1 << 17, 4


def bed(micro, **more):
    primitives = {"shape": "sphere", "per_side": 4, "size": 0.4, "seed": 1}
    return parse({"name": "mine", "about": "x", "primitives": primitives, "micro": micro, **more})


def pairs(n: int, wi: list[float]):
    random = rng(3)
    u, wo = torch.rand(n, 2, generator=random), square_to_disk(torch.rand(n, 2, generator=random))
    return u, torch.tensor(wi).expand(n, 2).contiguous(), wo


@pytest.mark.parametrize(
    ("micro", "more"),
    [
        ({"bsdf": "lambertian", "reflectance": "#d89070"}, {"ground": "lambertian"}),
        ({"bsdf": {"type": "roughconductor", "material": "none", "alpha": 0.4}}, {}),
    ],
)
def test_evaluations_have_the_mean_of_walks(micro, more):
    """The integral of f over each of 16 cells of directions is the share of particles there."""
    surface, wi = bed(micro, **more), [0.5, 0.3]
    u, rows, wo = pairs(N, wi)
    f = evaluate(surface, u, rows, wo, seed=1).double()
    channel = torch.arange(N) % 3
    exits = surface.walk(u, rows, channel, seed=2)
    for of in range(3):
        here, walks = channel == of, int((channel == of).sum())
        left = torch.bincount(cell(exits.wo[exits.left & here]), minlength=CELLS**2)
        share = left.double() / walks
        for k in range(CELLS**2):
            inside = math.pi * f[:, of] * (cell(wo) == k)
            error = math.hypot(
                float(inside.std()) / math.sqrt(N),
                float((share[k] * (1 - share[k]) / walks).sqrt()),
            )
            assert abs(float(inside.mean() - share[k])) < 4.5 * error


def cell(wo: torch.Tensor) -> torch.Tensor:
    at = (disk_to_square(wo.double()) * CELLS).long().clamp(0, CELLS - 1)
    return at[:, 0] * CELLS + at[:, 1]


def test_a_mirror_cannot_be_evaluated():
    with pytest.raises(InputError, match="mine: a mirror cannot be evaluated"):
        evaluate(bed("mirror"), *pairs(16, [0.1, 0.0]), seed=1)


# --- the comparison with what is learned from evaluations ---------------------------------


def held_out(walks: int) -> tuple[Held, list[torch.Tensor]]:
    """Particles distributed by known probabilities of the cells, and albedos known exactly."""
    random = rng(5)
    weight = torch.rand(3, COMPARED**2, generator=random, dtype=torch.float64)
    share = 0.6 * weight / weight.sum(1, keepdim=True)
    numbers = np.random.default_rng(6)
    count = torch.from_numpy(
        np.stack([numbers.multinomial(walks, [*p, 1 - p.sum()])[:-1] for p in share.numpy()])
    )
    nothing = torch.zeros(3, 2)
    survival = Survival(nothing, nothing, torch.full((3, 3), 0.6), walks, Counts())
    return Held(Conditions(nothing, nothing, torch.arange(3), count), survival), list(share)


def test_the_truth_has_no_error_and_an_error_is_told_from_noise(monkeypatch):
    monkeypatch.setattr(evaluations, "WALKS", walks := 1 << 16)
    held, share = held_out(walks)
    albedo = torch.full((3, 3), 0.6, dtype=torch.float64)
    right = evaluations.errors(held, share, albedo)
    # The noise of a single cell is 0.25 of its share here.
    assert abs(right["relative squared error of f"]) < 0.01
    assert abs(right["KL (nats)"]) < 0.003
    assert right["albedo within 3 %"] == 1
    twice = evaluations.errors(held, [2 * s for s in share], 2 * albedo)
    assert twice["relative squared error of f"] == pytest.approx(1, abs=0.05)
    assert twice["KL (nats)"] == pytest.approx(right["KL (nats)"], abs=1e-9)
    assert twice["mean albedo off by"] == pytest.approx(1, rel=1e-6)


def test_the_command_compares_both(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(evaluations, "WALKS", 2048)
    monkeypatch.setattr(evaluations, "_LANES", 4096)
    few = partial(Held.draw, conditions=2, directions=2, group=64)
    monkeypatch.setattr(evaluations.Held, "draw", few)
    torch.manual_seed(1)
    small = Architecture(width=8, layers=1, steps=1, albedo_width=4)
    surface = surfaces.load("clay-beads")
    spent = {"data_seconds": 0.1, "train_seconds": 0.1}
    about = {"name": surface.name, "description": surface.identity(), **spent}
    storage.save(tmp_path / "mine.safetensors", PureSample(small).eval(), about)
    monkeypatch.setattr("sys.argv", ["evaluations", str(tmp_path / "mine.safetensors")])
    evaluations.main()
    said = capsys.readouterr().out
    blocks = int(re.search(r"([0-9,]+) evaluations", said).group(1).replace(",", "")) / 4096
    # How many blocks the seconds allow is the machine's matter.
    assert "clay-beads" in said and "KL (nats)" in said and blocks >= 1 and blocks == int(blocks)
