"""Training seeds and measuring seeds: what is planned, and what their spread says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from harness.analysis.combine import Z95, Estimate, over_seeds
from harness.analysis.results import Results
from harness.analysis.seeds import ONE_SEED, over_training_seeds, training_spread
from harness.core.protocol.errors import InputError
from harness.report.parts import part
from harness.suite.load import load
from harness.suite.plan import make_plan
from harness.suite.seeds import pairs
from tests import fakes
from tests.report_results import Made

# --- the plan ----------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def test_pairs():
    """Fits are measured apart; the first as without training seeds."""
    assert pairs([0, 3], None) == [(0, 0), (3, 3)]
    assert pairs([0, 1], [0, 2]) == [(0, 0), (0, 1), (2, 2000), (2, 2001)]
    with pytest.raises(InputError, match="less than 1000 apart"):
        pairs([0, 1000], [0, 1])


def test_a_fit_is_planned_once_and_measured_with_every_seed(tmp_path: Path):
    """Three fits, two seeds each; keys of the first fit are those of a suite without them."""
    suite = fakes.suite(tmp_path, seeds=[0, 1], training_seeds=[0, 1, 2])
    plan = make_plan(load(suite))
    cells = len(plan.labels("material")) * len(plan.labels("method"))
    fits = [t for t in plan.trials if t.measure == "fit"]
    assert len(fits) == 3 * cells
    measured = [t for t in plan.trials if t.measure != "fit"]
    assert len(measured) == 2 * 3 * 2 * cells
    by_hash = {t.hash: t for t in fits}
    for trial in measured:
        training = by_hash[trial.fit].seed
        assert trial.seed // 1000 == training
        assert trial.identity.get("training_seed", trial.seed) == training
    plain = make_plan(load(fakes.suite(tmp_path, seeds=[0])))
    assert {t.hash for t in plain.trials} <= {t.hash for t in plan.trials}


def test_what_does_not_depend_on_the_fit_is_measured_with_the_first(tmp_path: Path):
    methods = ["adapters.py:Good", {"name": "adapters.py:Named", "first_fit_only": True}]
    measures = ["probe", {"name": "clock", "first_fit_only": True}]
    changes = {"methods": methods, "measures": measures}
    plan = make_plan(load(fakes.suite(tmp_path, training_seeds=[2, 3], **changes)))
    of_material = [t for t in plan.trials if t.material == "fake-a"]
    good, named = plan.labels("method")
    assert {(t.method, t.measure, t.seed) for t in of_material} == {
        *((label, "fit", 2) for label in (good, named)),
        *((label, measure, 2000) for label in (good, named) for measure in ("probe", "clock")),
        (good, "fit", 3),
        (good, "probe", 3000),
    }
    whole = make_plan(load(fakes.suite(tmp_path / "whole", training_seeds=[2, 3])))
    assert {t.hash for t in plan.trials} < {t.hash for t in whole.trials}
    methods = [{"name": "adapters.py:Good", "label": "Good", "first_fit_only": True}, methods[1]]
    with pytest.raises(InputError, match="baseline: 'Good' has first_fit_only"):
        load(fakes.suite(tmp_path, methods=methods))


def test_a_measure_may_be_of_some_materials_and_scenes(tmp_path: Path):
    """Trials of the others are not planned; those that are have the keys that they had."""
    measures = ["probe", {"name": "clock", "materials": ["fake-b"]}]
    plan = make_plan(load(fakes.suite(tmp_path, measures=measures)))
    clocked = {t.material for t in plan.trials if t.measure == "clock"}
    assert clocked == {"fake-b"} < {t.material for t in plan.trials if t.measure == "probe"}
    whole = make_plan(load(fakes.suite(tmp_path / "whole")))
    assert {t.hash for t in plan.trials} < {t.hash for t in whole.trials}
    for key, wrong in (("materials", "fake-c"), ("scenes", "nowhere")):
        measures = [{"name": "clock", key: [wrong]}]
        with pytest.raises(InputError, match=rf"measures\[0\]\.{key}.*{wrong}"):
            load(fakes.suite(tmp_path, measures=measures))


def test_a_profile_has_its_own(tmp_path: Path):
    """And a seed that stands twice is refused, with its place."""
    quick = {"training_seeds": [4]}
    plan = make_plan(load(fakes.suite(tmp_path, profiles={"quick": quick})))
    assert {t.seed for t in plan.trials} == {4, 4000}
    with pytest.raises(InputError, match=r"training_seeds\[1\]: '1' is listed twice"):
        load(fakes.suite(tmp_path, training_seeds=[1, 1]))
    with pytest.raises(InputError, match=r"profiles.quick.training_seeds\[1\]: '5' is listed"):
        load(fakes.suite(tmp_path, profiles={"quick": {"training_seeds": [5, 5]}}))


# --- numbers over seeds ------------------------------------------------------------------

NOISE, BETWEEN = 0.05, 0.15


def measured(rng: np.random.Generator, fits: int, seeds: int, between: float) -> dict:
    """Estimates by training seed, lognormal around one, each with the interval of its noise."""
    found = {}
    for fit in range(fits):
        centre = between * rng.standard_normal()
        logs = centre + NOISE * rng.standard_normal(seeds)
        half = Z95 * NOISE
        found[fit] = [
            Estimate(*(math.exp(x + d) for d in (0, -half, half))) for x in map(float, logs)
        ]
    return found


@pytest.mark.parametrize(
    ("fits", "seeds"),
    [(3, 4), (2, 2), *(pytest.param(*s, marks=pytest.mark.slow) for s in ((3, 1), (5, 1)))],
)
@pytest.mark.parametrize("between", [0.0, BETWEEN])
def test_intervals_hold_both_spreads(fits: int, seeds: int, between: float):
    """95 in a hundred intervals hold the mean of all fits there could be."""
    rng = np.random.default_rng(fits + 10 * seeds)
    hits = 0
    for _ in range(2000):
        number = over_training_seeds(measured(rng, fits, seeds, between))
        hits += number.low <= 1 <= number.high
    assert 0.935 < hits / 2000 < 0.965


def test_measuring_seeds_are_not_fits():
    """Taken for independent, four seeds of each of three fits would be far too sure."""
    rng, hits = np.random.default_rng(0), 0
    for _ in range(1000):
        everything = [e for group in measured(rng, 3, 4, BETWEEN).values() for e in group]
        number = over_seeds(everything)
        hits += number.low <= 1 <= number.high
    assert hits / 1000 < 0.8


def test_one_fit_keeps_its_interval():
    """And has no spread, which is said."""
    one = {0: [Estimate(2.0, 1.9, 2.1)]}
    assert over_training_seeds(one) == Estimate(2.0, 1.9, 2.1)
    assert training_spread([one, one]) == ONE_SEED
    assert isinstance(training_spread([{0: [Estimate(1.0)], 1: [Estimate(2.0)]}]), str)
    assert isinstance(training_spread([{0: [Estimate(math.inf)], 1: [Estimate(2.0)]}]), str)


def test_spread_between_fits_is_told_from_noise():
    """Its interval holds the true one in 95 of a hundred; of noise alone it reaches down to none.

    The noise is known from the intervals, so that the interval of the spread is that of a
    variance.
    """
    rng, hits, none = np.random.default_rng(1), 0, 0
    for _ in range(600):
        found = training_spread([measured(rng, 3, 1, BETWEEN) for _ in range(4)])
        hits += found.low <= math.exp(BETWEEN) <= found.high
        none += training_spread([measured(rng, 3, 1, 0.0) for _ in range(4)]).low == 1
    assert 0.92 < hits / 600 < 0.98 and none / 600 > 0.95


# --- the table ---------------------------------------------------------------------------


def test_table(tmp_path: Path):
    """Materials and all of them together; the reference has its reason, one seed has no table."""
    made = Made(seeds=(0, 1, 2), measures=("fit", "equal-time", "pdf"))
    table = part("tables", "training-seeds")(Results.load(made.write(tmp_path / "three")))
    assert [section.title for section in table.sections] == [
        "speed-up at equal time, studio-sphere",
        "KL divergence",
    ]
    assert table.caption == "3 training seeds a method and material."
    rows = table.sections[0].rows
    assert [row.label for row in rows] == [*made.materials, "all materials"]
    at = table.columns.index("cosine")
    cell = rows[-1].cells[at]
    assert cell.low <= cell.value <= cell.high and cell.text.startswith("×")
    baseline = rows[0].cells[table.columns.index("improved-baseline")]
    assert baseline.missing == "the reference: one by definition"
    one = Made(measures=("fit", "pdf")).write(tmp_path / "one")
    assert str(part("tables", "training-seeds")(Results.load(one))).startswith(ONE_SEED)
