"""Numbers as they are printed, and how they are combined."""

from __future__ import annotations

import math

import numpy as np
import pytest

from harness.analysis import numbers
from harness.analysis.combine import Estimate, arithmetic_mean, geometric_mean, over_seeds, ratio

# --- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "low", "high", "expected"),
    [
        (1.87, 1.72, 2.02, ("1.87", "[1.72, 2.02]")),
        (0.15294, 0.146, 0.160, ("0.153", "[0.146, 0.160]")),
        (2.361, 1.9, 2.8, ("2.4", "[1.9, 2.8]")),
        (123456.0, 121000.0, 126000.0, ("1.23e5", "[1.21e5, 1.26e5]")),
        (1234.4, 1200.0, 1260.0, ("1230", "[1200, 1260]")),
        (0.00002, 0.000015, 0.00003, ("2.0e−5", "[1.5e−5, 3.0e−5]")),
        (-0.13, -0.3, 0.04, ("−0.13", "[−0.30, 0.04]")),
        (0.0, None, None, ("0", "")),
        (math.inf, None, None, ("∞", "")),
        (3.14159, math.nan, math.nan, ("3.14", "")),
        (5.0, 5.0, 5.0, ("5.00", "")),
    ],
)
def test_digits_follow_the_interval(value, low, high, expected):
    assert numbers.with_interval(value, low, high) == expected


def test_a_value_stays_inside_its_printed_interval():
    random = np.random.default_rng(1)
    for _ in range(2000):
        value = 10 ** random.uniform(-6, 7)
        low, high = value * random.uniform(0.2, 1), value * random.uniform(1, 4)
        text, interval = numbers.with_interval(value, low, high)
        shown = float(text.replace("−", "-"))
        bounds = [float(x) for x in interval.strip("[]").replace("−", "-").split(", ")]
        assert shown == pytest.approx(value, rel=0.06)
        assert bounds[0] * 0.95 <= shown <= bounds[1] * 1.05


def test_units():
    assert [numbers.duration(s) for s in (0, 2e-5, 0.05, 9.96, 80, 7300)] == [
        "0 s", "20 µs", "50 ms", "10.0 s", "1.3 min", "2.0 h",
    ]  # fmt: skip
    assert [numbers.count(n) for n in (0, 999, 18432, 1.5e6)] == ["0", "999", "18.4 k", "1.50 M"]
    assert [numbers.size(n) for n in (0, 512, 73728, 2**22)] == [
        "0 B", "512 B", "72.0 KiB", "4.00 MiB",
    ]  # fmt: skip
    assert [numbers.p_value(p) for p in (1e-9, 0.0234, 0.5)] == ["<0.001", "0.023", "0.50"]


# --- combining -----------------------------------------------------------------------------------


def test_geometric_mean_of_equal_numbers_narrows_with_the_root_of_n():
    one = Estimate(2.0, 1.8, 2.0**2 / 1.8)
    mean = geometric_mean([one] * 4, 4)
    assert mean.value == pytest.approx(2.0)
    assert math.log(mean.high / 2) == pytest.approx(math.log(one.high / 2) / 2)
    assert mean.note == ""
    assert "3 of 4" in geometric_mean([one] * 3, 4).note
    with pytest.raises(ValueError, match="positive and finite"):
        geometric_mean([one, Estimate(0.0)], 2)


def test_geometric_mean_covers_its_claim():
    random = np.random.default_rng(3)
    truth, sd, hits = np.array([0.5, 2.0, 7.0]), 0.1, 0
    for _ in range(600):
        seen = truth * np.exp(sd * random.standard_normal(3))
        factor = math.exp(1.96 * sd)
        mean = geometric_mean([Estimate(x, x / factor, x * factor) for x in seen], 3)
        hits += mean.low <= truth.prod() ** (1 / 3) <= mean.high
    assert 0.92 < hits / 600 < 0.98


def test_arithmetic_mean_and_ratio():
    mean = arithmetic_mean([Estimate(1.0, 0.0, 2.0), Estimate(-1.0, -2.0, 0.0)], 2)
    assert (mean.value, mean.high) == (0.0, pytest.approx(math.sqrt(2) / 2))
    quotient = ratio(Estimate(4.0, 2.0, 8.0), Estimate(2.0))
    assert (quotient.value, quotient.low) == (2.0, None)
    quotient = ratio(Estimate(4.0, 2.0, 8.0), Estimate(2.0, 1.0, 4.0))
    assert quotient.high == pytest.approx(2.0 * 2 ** math.sqrt(2))


def test_seeds_widen_the_interval_by_their_spread():
    alone = Estimate(1.0, 0.99, 1.01)
    assert over_seeds([alone]) is alone
    apart = over_seeds([Estimate(v, 0.99 * v, 1.01 * v) for v in (0.5, 1.0, 2.0)])
    assert apart.value == pytest.approx(1.0)
    assert apart.low < 0.7 and apart.high > 1.4
    together = over_seeds([alone] * 3)
    assert together.high - together.low < 0.02
    assert math.isinf(over_seeds([alone, Estimate(math.inf)]).value)
