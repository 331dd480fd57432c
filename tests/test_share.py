"""Intervals of mean shares: they stay between zero and one, and hold the mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from harness.stats.share import mean_share


@given(st.lists(st.floats(0, 1), min_size=2, max_size=80))
@example([0.0, 5e-324])
@example([0.0, 1e-100])
@example([0.3, 0.3, 0.3 + 1e-16])
@settings(max_examples=100, deadline=None)
def test_an_interval_of_a_share_is_one_of_shares(x: list[float]):
    value, low, high = mean_share(x)
    assert 0 <= low <= high <= 1
    assert low <= value + 1e-12 or value < 1e-3
    assert value == pytest.approx(np.mean(x))


@pytest.mark.parametrize(("rate", "samples"), [(0.02, 128), (0.2, 16), (0.5, 1)])
def test_it_holds_the_mean_as_often_as_it_says(rate: float, samples: int):
    """Shares of samples over conditions whose rates differ, 64 conditions."""
    random = np.random.default_rng(3)
    a = 0.7
    held = 0
    for _ in range(600):
        rates = random.beta(a, a * (1 - rate) / rate, 64)
        low, high = mean_share(random.binomial(samples, rates) / samples)[1:]
        held += low <= rate <= high
    assert 0.92 <= held / 600 <= 0.99


def test_what_is_no_share_is_refused():
    with pytest.raises(ValueError, match="between 0 and 1"):
        mean_share([0.5, 1.5])
    with pytest.raises(ValueError, match="between 0 and 1"):
        mean_share([])


@pytest.mark.parametrize("share", [0.25, 0.4725607127499051])
@pytest.mark.parametrize("count", [1, 3, 9])
def test_the_same_share_everywhere_is_known(share: float, count: int):
    assert tuple(mean_share([share] * count)) == (share, share, share)


@pytest.mark.parametrize("spread", [1e-3, 3e-5, 2e-5, 1e-9])
def test_shares_that_hardly_differ_have_the_interval_of_a_normal_mean(spread: float):
    """On both sides of where the quantiles of Beta are left for those of Student."""
    x = 0.3 + spread * np.array([-1.0, 1.0, 0.5, -0.5])
    value, low, high = mean_share(x)
    half = stats.t.ppf(0.975, 3) * stats.sem(x)
    assert [low, high] == pytest.approx([value - half, value + half], abs=0.01 * half)
