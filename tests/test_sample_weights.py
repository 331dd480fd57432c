"""Variance, noise and bias of weights, against what they are known to be."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from harness.core import registry
from harness.core.protocol.method import Budget
from harness.materials import registry as materials
from tests.materials import MATERIALS
from tests.measuring import run

COPPER = {"alpha_x": 0.4, "alpha_y": 0.4, "r0_r": 0.9, "r0_g": 0.9, "r0_b": 0.9}


def measured(material, method, conditions: int = 8, samples: int = 4096):
    method.bind(material)
    job = SimpleNamespace(
        material=material,
        method=method,
        generator=torch.Generator().manual_seed(3),
        budget=Budget(),
        settings={"conditions": conditions, "samples": samples},
    )
    (outcome,) = run("sample-weights", [job])
    return {r.metric: r.value for r in outcome.records}, outcome.arrays


def copper(walks: int):
    spec = {"name": "copper", "type": "family", "family": "ggx-conductor", "fix": COPPER}
    return materials.make({**spec, "walks": walks})


class Darker:
    """A sampler whose estimates are a tenth too small."""

    def __init__(self):
        self.inner = registry.make("random-walk")
        self.name, self.exact_pdf = "darker", False

    def bind(self, material):
        self.material = material
        self.inner.bind(material)

    def rebound(self, material):
        return self

    def sample_weighted(self, condition, u):
        found = self.inner.sample_weighted(condition, u)
        return found._replace(weight=0.9 * found.weight)


def test_cosine_of_a_lambertian_has_no_variance():
    chalk = materials.make({"name": "chalk", "type": "mitsuba", "bsdf": {"type": "diffuse"}})
    value, _ = measured(chalk, registry.make("cosine"))
    assert value["relative-variance"] == pytest.approx(value["noise-free-variance"], abs=1e-12)
    assert value["relative-variance"] < 1e-10 and abs(value["bias"]) < 1e-5


def test_variance_is_that_of_quadrature():
    """E[(f/p)^2] / A^2 - 1 of uniform directions on the disk, where f is a closed form."""
    from harness.core.protocol.disk import luminance, square_to_disk

    material = MATERIALS["tilted"]()
    value, arrays = measured(material, registry.make("cosine"), 4, 1 << 15)
    u = torch.rand(1 << 17, 2, generator=torch.Generator().manual_seed(5))
    expected = []
    for row in torch.from_numpy(arrays["condition"]):
        f = luminance(material.eval(row.expand(len(u), -1), square_to_disk(u))).double()
        expected.append(float(f.var() / f.mean() ** 2))
    assert value["relative-variance"] == pytest.approx(np.mean(expected), rel=0.05)
    assert value["noise-free-variance"] == pytest.approx(value["relative-variance"])


def test_noise_of_walks_falls_with_their_number_and_the_rest_stays():
    few, _ = measured(copper(2), registry.make("native"))
    many, _ = measured(copper(32), registry.make("native"))
    noise = [v["relative-variance"] - v["noise-free-variance"] for v in (few, many)]
    assert noise[0] / noise[1] == pytest.approx(16, rel=0.4)
    assert few["noise-free-variance"] == pytest.approx(many["noise-free-variance"], rel=0.15)
    assert noise[0] > many["noise-free-variance"] / 2, "or there was nothing to be told apart"


def test_bias_is_seen_and_only_where_there_is_one():
    right, _ = measured(copper(4), registry.make("random-walk"))
    wrong, _ = measured(copper(4), Darker())
    assert right["noise-free-variance"] == pytest.approx(right["relative-variance"]), (
        "f is not in it"
    )
    assert abs(right["bias"]) < 0.005 and right["bias-rms"] < 0.01
    assert right["biased-share"] == 0
    assert wrong["bias"] == pytest.approx(-0.1, abs=0.005)
    assert wrong["bias-rms"] == pytest.approx(0.1, abs=0.005) and wrong["biased-share"] == 1


def test_records_and_table(tmp_path: Path):
    import yaml

    from harness.analysis.results import Results
    from harness.cli.main import main
    from harness.report.parts import part

    suite = {
        "name": "weights",
        "materials": ["ggx-conductor", "disney"],
        "methods": ["cosine", "native", "random-walk"],
        "baseline": "cosine",
        "measures": [{"name": "sample-weights", "conditions": 32, "samples": 256}],
        "report": {"tables": [], "figures": []},
    }
    (tmp_path / "weights.yaml").write_text(yaml.safe_dump(suite))
    assert main(["run", str(tmp_path / "weights.yaml"), "--out", str(tmp_path / "out")]) == 0
    table = part("tables", "sample-weights")(Results.load(tmp_path / "out"))
    titles = [s.title for s in table.sections]
    shares = next(s for s in table.sections if "less variance than cosine [1]" in s.title)
    assert titles[4].startswith("bias: ") and len(titles) == 9
    assert shares.rows[0].cells[0].missing and 0 < shares.rows[0].cells[2].value <= 1
    cells = {row.label: row.cells for row in table.sections[0].rows}
    assert cells["ggx-conductor"][2].value > 0 and cells["disney"][2].missing


def test_an_interval_of_more_than_a_factor_of_ten_is_no_number():
    from harness.analysis.combine import Estimate
    from harness.report.tables.sample_weights import resolved

    for fine in (Estimate(1.0, 0.5, 5.0), Estimate(0.0, 0.0, 0.0), Estimate(3.0), "skipped"):
        assert resolved(fine) is fine
    for wide in (Estimate(1.7, 6.6e-15, 1.2e15), Estimate(1.0, 0.5, 5.1), Estimate(1.0, 0.0, 2.0)):
        assert resolved(wide) == "not resolved: its interval spans more than a factor of 10"
