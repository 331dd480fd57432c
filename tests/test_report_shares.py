"""Shares stay between zero and one, and a divergence below zero has its reason."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import pytest

from harness.analysis.combine import Estimate
from harness.analysis.results import Results
from harness.analysis.shares import between, between_all
from harness.report.formats.csv import csv
from harness.report.formats.markdown import markdown
from harness.report.table import Table
from harness.report.tables.pdf import pdf

_AT = {
    "suite": "s", "scene": "", "measure": "pdf", "seed": 0, "unit": "1", "status": "ok",
    "reason": "", "material": "suede",
}  # fmt: skip


def results(found: dict[tuple[str, int], tuple[str, float, float, float]]) -> Results:
    """Of one record for each method and seed: metric, value and ends."""
    rows = [
        _AT | {"method": method, "seed": seed, "trial": f"{method}-{seed}", "metric": metric,
               "value": value, "ci_low": low, "ci_high": high}
        for (method, seed), (metric, value, low, high) in found.items()
    ]  # fmt: skip
    identity = {"identity": {"method": {"name": "a"}}}
    plan = {"trials": [{**row, **identity} for row in rows]}
    return Results(Path(), between_all(pd.DataFrame(rows)), plan)


@pytest.mark.parametrize(
    ("metric", "value", "ends", "shown"),
    [
        ("invalid-share", 0.005, (-0.004, 0.014), (0.0, 0.014)),
        ("lost-share", 0.99, (0.97, 1.02), (0.97, 1.0)),
        ("some-case/invalid", 0.01, (-0.2, 0.2), (0.0, 0.2)),
        ("invalid-share", 0.5, (0.4, 0.6), (0.4, 0.6)),
        ("invalid-share", -0.1, (-0.2, 0.0), (-0.2, 0.0)),  # an error is not made good
        ("kl", 0.005, (-0.004, 0.014), (-0.004, 0.014)),
    ],
)
def test_the_interval_of_a_share_is_cut_to_shares(metric, value, ends, shown):
    cut = between(metric, Estimate(value, *ends))
    assert (cut.value, cut.low, cut.high) == (value, *shown)
    frame = pd.DataFrame(
        [{"metric": metric, "value": value, "ci_low": ends[0], "ci_high": ends[1]}]
    )
    assert between_all(frame)[["ci_low", "ci_high"]].to_numpy().tolist() == [list(shown)]


def test_without_an_interval_there_is_none():
    assert between("a-share", Estimate(0.5, None, None)) == Estimate(0.5, None, None)
    frame = pd.DataFrame([{"metric": "a-share", "value": 0.5, "ci_low": math.nan, "ci_high": 0.7}])
    low, high = between_all(frame)[["ci_low", "ci_high"]].to_numpy()[0]
    assert math.isnan(low) and high == 0.7


def test_over_seeds_a_share_stays_one():
    """Student's interval of two seeds of 0 and 0.01 reaches far below zero."""
    seeds = {
        ("a", 0): ("invalid-share", 0.0, 0.0, 0.0),
        ("a", 1): ("invalid-share", 0.01, 0.0, 0.02),
    }
    number = results(seeds).number("pdf", "invalid-share", "suede", "a")
    assert isinstance(number, Estimate)
    assert number.value == pytest.approx(0.005) and number.low == 0.0 and number.high <= 1.0


def test_a_divergence_below_zero_has_its_reason():
    made = pdf(results({
        ("below", 0): ("kl", -0.02, -0.03, -0.01), ("reaches", 0): ("kl", 0.05, -0.04, 0.14),
        ("above", 0): ("kl", 0.05, 0.04, 0.06),
    }))  # fmt: skip
    assert isinstance(made, Table)
    below, reaches, above = made.sections[0].rows[0].cells
    assert "below zero is no divergence" in below.warning
    assert "reaches below zero" in reaches.warning and not above.warning
    assert (below.value, reaches.low) == (-0.02, -0.04)  # what was measured is not changed
    for text in (csv(made), markdown(made)):
        assert "below zero is no divergence" in text and "reaches below zero" in text
