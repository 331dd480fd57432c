"""Published copies of results: long arrays keep four digits, everything else its bits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from harness.store.publish import rounded


@settings(deadline=None, max_examples=50, derandomize=True, database=None)
@given(
    arrays.arrays(
        np.float64, st.integers(32, 80), elements=st.floats(-1e30, 1e30).filter(lambda v: v == v)
    )
)
def test_long_arrays_are_rounded_to_nearest(array: np.ndarray):
    found = rounded(array)
    tiny = np.abs(array[array != 0]).min(initial=1) < np.finfo(np.float32).tiny
    if tiny:
        assert found is array, "single precision has not their range"
        return
    assert found.dtype == np.float32
    assert (np.abs(found - array) <= 2.0**-15 * np.abs(array) * (1 + 1e-6)).all()
    assert (found.view(np.uint32) & 511 == 0).all()
    assert np.array_equal(rounded(found), found), "once is enough"


def test_what_is_not_finite_stays():
    array = np.linspace(-1, 1, 64)
    array[[3, 5, 7]] = np.nan, np.inf, -np.inf
    found = rounded(array)
    assert np.isnan(found[3]) and found[5] == np.inf and found[7] == -np.inf
    assert np.isfinite(np.delete(found, [3, 5, 7])).all()


@pytest.mark.parametrize(
    "array",
    [np.pi * np.ones(31), np.arange(64), np.ones(64, bool), np.full(64, 1e39), np.full(64, 1e-39)],
    ids=["short", "integers", "truth", "large", "small"],
)
def test_everything_else_is_as_it_was(array: np.ndarray):
    assert rounded(array) is array
