"""The laws' quantiles and tails against scipy.stats."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from harness.stats.distributions import (
    binomial_cdf,
    binomial_sf,
    chi2_isf,
    chi2_sf,
    normal_isf,
    normal_sf,
    pareto_sf,
    t_quantile,
    t_sf,
)

TAILS = st.floats(1e-12, 1 - 1e-9)
REAL = st.floats(-30, 30)
DOF = st.integers(1, 5000)


@given(TAILS, REAL, DOF)
def test_normal_student_and_chi_square(tail, x, dof):
    assert normal_isf(tail) == pytest.approx(stats.norm.isf(tail), rel=1e-10, abs=1e-12)
    assert normal_sf(x) == pytest.approx(stats.norm.sf(x), rel=1e-10)
    assert t_quantile(tail, dof) == pytest.approx(stats.t.ppf(tail, dof), rel=1e-8, abs=1e-12)
    assert t_sf(x, dof) == pytest.approx(stats.t.sf(x, dof), rel=1e-8)
    assert chi2_isf(tail, dof) == pytest.approx(stats.chi2.isf(tail, dof), rel=1e-8)
    assert chi2_sf(10 * x, dof) == pytest.approx(stats.chi2.sf(10 * x, dof), rel=1e-8)


@given(st.integers(1, 10**6), st.floats(0, 1), st.integers(-2, 40))
def test_binomial(n, p, k):
    k = min(k, n + 1)
    assert binomial_cdf(k, n, p) == pytest.approx(stats.binom.cdf(k, n, p), rel=1e-8, abs=1e-300)
    assert binomial_sf(k, n, p) == pytest.approx(stats.binom.sf(k, n, p), rel=1e-8, abs=1e-300)


@given(st.floats(0, 50), st.floats(-2, 2), st.floats(0.1, 5))
def test_generalised_pareto(x, index, scale):
    expected = stats.genpareto.sf(x, index, scale=scale)
    assert pareto_sf(x, index, scale) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_arrays_broadcast_and_nothing_is_no_number():
    assert t_sf(np.array([0.0, 1.0]), np.array([3, 4])).shape == (2,)
    assert np.isnan(t_quantile(0.975, 0))
    assert np.isnan(t_quantile(np.nan, 3))
