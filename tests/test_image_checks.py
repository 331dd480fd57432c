"""Methods as a renderer uses them: white furnace, mean images, MIS on, off and misled."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.image_checks import ROUNDING
from harness.analysis.results import Results
from harness.core import registry
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.materials import registry as materials
from harness.measures import registry as measures
from harness.measures.base import Job
from harness.mitsuba_runtime import variant
from harness.report.table import Table
from harness.report.tables.image_checks import CHECKS, NOISELESS, RATIOS, image_checks
from harness.scenes import registry as scenes
from tests import measuring
from tests.test_rendering import White, mitsuba, white

mi = variant.use("cpu")

from harness.measures.image_checks import FURNACE, is_white  # noqa: E402
from harness.rendering.prepared import prepare  # noqa: E402
from tests.image_subjects import ALPHA, BUDGET, STUDIO, Image, Tilted, compare, fitted, grey, image  # noqa: E402


class FivePercent(Tilted):
    """Its weights are five per cent too large."""

    name = "five-percent"
    factor = 1 / 1.05


class DropsLarge(Tilted):
    """Without the largest weights: at x < -0.9 on the disk."""

    name = "drops-large"
    limit = 1 / (1 - 0.45)


class Tripled(Tilted):
    """A density three times too large, in the value too."""

    name = "tripled"
    factor = 3.0


class OtherDensity(Tilted):
    """Its ``pdf`` is not the density of its samples, whose own is right."""

    name = "other-density"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo = super().sample(condition, u).wo
        return DiskSample(wo, Tilted.pdf(self, condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return super().pdf(condition, wo) * (1 + 0.5 * wo[:, 1])


class Hole(Tilted):
    """Never to the side x < -0.5, without saying so in the weights of the rest."""

    name = "hole"

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """See :meth:`Method.sample`."""
        wo, pdf = super().sample(condition, u)
        return DiskSample(torch.where(wo[:, :1] < -0.5, 2.0, wo), pdf)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        return torch.where(wo[:, 0] < -0.5, 0, super().pdf(condition, wo))


def job(method: Method, material: Material, scene: Any = STUDIO, **given: Any) -> Job:
    """As the runner makes it."""
    return Job(
        trial=None,
        material=material,
        method=method,
        scene=scene,
        seed=0,
        generator=torch.Generator().manual_seed(0),
        settings=measures.settings("image-checks", given),
        budget=BUDGET,
        make=lambda: type(method)(),
    )


def run(method: str | Method, material: Material, scene: Any = STUDIO, **given: Any):
    """Records of the measure, by metric, at a size for tests."""
    given = {"batches": 6, "spp": 16, "resolution": 24, "reference_spp": 1024, **given}
    method = fitted(method, material)
    outcome = measuring.run("image-checks", [job(method, material, scene, **given)])[0]
    assert outcome.status == "ok"
    found = {r.metric: r for r in outcome.records}
    assert len(found) == len(outcome.records)
    return found


def furnace_p(method: Method, material: Material, spp: int = 32) -> float:
    """p-value of one being the mean of the white furnace."""
    prepared = prepare(FURNACE, material, method, 24)
    assert prepared.mask.all()
    seen = image(prepared, spp, 100)
    ones = np.ones_like(seen.mean)
    return compare(seen, Image(ones, 0 * ones), prepared.mask).p_value


# --- the furnace -----------------------------------------------------------------------


SAMPLERS = [
    name for name in registry.names() if registry.load(name).exact_pdf and name != "puresample"
]
"""Of any material. A random walk knows its own families alone, see test_random_walk, and the
sampler of materials learned from walks those alone, see test_puresample; the published importance
baking is biased and says so."""


DEAR = """
    importance-baked flow-matching histogram-mixture neural-spline-flow realnvp reparameterised
""".split()
"""Samplers whose kernels or fits take long."""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in DEAR else ()) for n in SAMPLERS]
)
def test_white_furnace(name):
    """All methods: a surface that reflects all light is as bright as the light."""
    material = white()
    method = fitted(name, material)
    assert method.supports(material)[0]
    assert furnace_p(method, material, spp=4 if name in ("histogram", "tabulated") else 32) > ALPHA


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("material", ["suede", "brushed-metal"])
def test_furnace_of_materials(name, material):
    """All methods: constant light shows the albedo, and all other checks pass, too."""
    found = run(name, materials.make(material), resolution=32, spp=64, reference_spp=2048)
    assert found["p"].value > ALPHA
    assert found["furnace"].ci_low - 0.05 < 0 < found["furnace"].ci_high + 0.05


@pytest.mark.parametrize("make", [white, White], ids=["mitsuba", "torch"])
@pytest.mark.parametrize("method", [FivePercent, DropsLarge, Tripled, Hole])
def test_furnace_catches(make, method):
    """Weights that are wrong by five per cent, large ones that are dropped, a pdf that is not."""
    material = make()
    assert furnace_p(fitted(Tilted(), material), material) > ALPHA
    assert furnace_p(fitted(method(), material), material) < 1e-12


def test_rounding_is_no_bias():
    """An image without noise agrees up to single precision's rounding, and no further."""
    rng = np.random.default_rng(0)
    ones = np.ones((32, 32))
    everywhere, expected = np.ones((32, 32), bool), Image(ones, 0 * ones)
    jitter = 1 + 2.0**-22 * rng.integers(-4, 5, ones.shape)
    for mean in (ones, (1 - ROUNDING / 4) * ones, jitter):
        assert compare(Image(mean, 0 * ones), expected, everywhere).p_value > 0.3
    for bias in (1e-4, -1e-4):
        assert compare(Image(ones + bias, 0 * ones), expected, everywhere).p_value < 1e-6
    # With noise, that decides: the same bias far below it is no news.
    noise = Image(ones + 1e-4 + 0.01 * rng.standard_normal(ones.shape), 1e-4 * ones)
    assert compare(noise, expected, everywhere).p_value > ALPHA


def test_furnace_loses_no_light():
    """A cosine sample of a white Lambertian has the weight one: a pixel has no other value."""
    material = white()
    done = prepare(FURNACE, material, fitted("cosine", material), 24).render(1024, 1)
    lost = 1 - done.mean
    # A ray in a million falls through an edge between facets.
    assert (np.abs(lost) > 1e-5).sum() <= 8 and lost.mean() < 8 / (1024 * 24 * 24)


def test_is_white():
    """Albedo one, the same for all directions."""
    own = torch.Generator().manual_seed(0)
    assert is_white(white(), own) and is_white(White(), own)
    assert not is_white(grey(), own) and not is_white(White(0.999), own)
    assert not is_white(materials.make("suede"), own)


# --- the measure -----------------------------------------------------------------------


def test_measure():
    """All checks of a right method, with intervals; its numbers fit together."""
    found = run("cosine", grey())
    assert set(found) == {
        *(f"{c}{end}" for c in CHECKS for end in ("", "-z", "-p")),
        *RATIOS,
        "p",
        "spp",
    }
    assert found["p"].value > ALPHA
    assert found["p"].value <= 6 * min(found[f"{c}-p"].value for c in CHECKS)
    for name in (*CHECKS, *RATIOS):
        record = found[name]
        assert record.ci_low < record.value < record.ci_high and record.unit == "1"
    assert found["mis-variance"].ci_high < 1 < found["tripled-variance"].ci_low
    assert found["spp"].value == 96


def test_measure_of_an_exact_sampler():
    """Furnace without noise; in constant light MIS only adds some."""
    found = run("cosine", white(), scene=scenes.make("uniform-sphere"), reference_spp=64)
    assert abs(found["furnace"].value) < 1e-5 and found["furnace-p"].value > 0.3
    assert found["mis-variance"].value == math.inf
    assert found["tripled-variance"].ci_high < 1
    assert found["p"].value > ALPHA


@pytest.mark.parametrize(
    ("method", "guilty", "innocent"),
    [
        (FivePercent, ("furnace",), ()),
        # Its two strategies differ in the mean: weighed otherwise, they give another one.
        (Tripled, ("furnace", "reference", "mis", "tripled"), ()),
        (Hole, ("furnace", "mis"), ("mis-reference", "tripled", "tilted")),
        (OtherDensity, ("mis-reference",), ("furnace", "reference")),
    ],
)
def test_measure_catches(method, guilty, innocent):
    """Each fault by the check that is there for it, and not by one that cannot see it."""
    found = run(method(), grey(), spp=48)
    for check in guilty:
        assert found[f"{check}-p"].value < 1e-4, check
    for check in innocent:
        assert found[f"{check}-p"].value > ALPHA, check
    assert found["p"].value < ALPHA


def test_black_material():
    """Nothing is reflected, nothing is relative to it; still no nan."""
    black = mitsuba("diffuse", reflectance={"type": "rgb", "value": 0.0})
    found = run("cosine", black, reference_spp=64)
    assert set(found) == {*(f"{c}{end}" for c in CHECKS for end in ("-z", "-p")), "p", "spp"}
    assert found["p"].value == 1


# --- the table -------------------------------------------------------------------------


def table(rows: list[dict[str, Any]]) -> Table | str:
    """Of stored records."""
    import pandas as pd

    columns = {"suite": "s", "scene": "studio-sphere", "measure": "image-checks", "seed": 0}
    columns |= {"ci_low": math.nan, "ci_high": math.nan, "unit": "1", "status": "ok", "reason": ""}
    full = [{**columns, "trial": f"{row['material']}-{row['method']}", **row} for row in rows]
    plan = {
        "trials": [
            {"method": m, "identity": {"method": {"name": m}}, "trial": f"suede-{m}", "seed": 0}
            for m in dict.fromkeys(row["method"] for row in rows)
        ]
    }
    return image_checks(Results(Path(), pd.DataFrame(full), plan))


def test_table():
    """p-values corrected over the whole table, a mark where one is small, ratios, daggers."""
    rows = []
    for method, p in (("right", 0.02), ("wrong", 1e-9)):
        at = {"material": "suede", "method": method}
        rows += [{**at, "metric": f"{c}-p", "value": p} for c in CHECKS]
        rows += [{**at, "metric": c, "value": -0.05} for c in CHECKS]
        rows.append({**at, "metric": "mis-variance", "value": 2.0, "ci_low": 1.9, "ci_high": 2.1})
    rows.append(
        {
            "material": "suede",
            "method": "lost",
            "metric": "",
            "value": math.nan,
            "status": "timeout",
            "reason": "slow",
        }
    )
    made = table(rows)
    assert isinstance(made, Table) and made.columns == ["right", "wrong", "lost"]
    (section,) = made.sections
    assert section.title == "studio-sphere, suede" and len(section.rows) == 9
    right, wrong, lost = section.rows[0].cells
    # Six of the twelve are smaller: the others count six times.
    assert right.value == pytest.approx(0.12) and not right.warning
    assert wrong.value == pytest.approx(1.2e-8) and "wrong on suede, furnace" in wrong.warning
    assert "-5.00%" in wrong.warning and lost.missing == "timeout: slow"
    ratio, missing = section.rows[6].cells[0], section.rows[7].cells[0]
    assert (ratio.value, ratio.low, ratio.high, ratio.suffix) == (2.0, 1.9, 2.1, "×")
    assert missing.missing == NOISELESS
    assert "6 of 12" in made.caption


def test_no_table():
    """Of a suite without the measure."""
    row = {"material": "suede", "method": "cosine", "metric": "kl", "value": 1.0, "measure": "pdf"}
    assert table([row]) == "no trial of the measure image-checks is stored"


def test_stale_tests_are_shown_and_marked():
    """They count in Holm's correction with the others."""
    at = {"material": "suede", "method": "old", "status": "stale", "reason": "stale: code changed"}
    made = table([{**at, "metric": "furnace-p", "value": 0.5}])
    cell = made.sections[0].rows[0].cells[0]
    assert cell.value == 0.5 and "code changed" in cell.warning
