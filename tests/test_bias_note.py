"""A note on bias over several seeds names the test that it stands on."""

from __future__ import annotations

from types import SimpleNamespace

import pandas as pd

from harness.analysis.bias import deciding_test


def frame(tests):
    """Rows of the measure with a p-value and a score for every seed."""
    return pd.DataFrame(
        {"measure": "equal-spp", "material": "m", "method": "cosine", "scene": "s",
         "seed": seed, "metric": metric, "value": value, "status": "ok"}
        for seed, (p, z) in tests.items()
        for metric, value in (("bias-p", p), ("bias-z", z), ("variance", 1.0))
    )  # fmt: skip


def test_the_score_is_that_of_the_p_value():
    """Scores of other seeds, which may have the other sign, do not count."""
    tests = {0: (0.4, -0.8), 3: (1e-5, 4.4), 7: (0.2, -1.3)}
    found = deciding_test(SimpleNamespace(frame=frame(tests)), "m", "cosine", "s")
    assert (found.seed, found.seeds, found.p, found.z) == (3, 3, 1e-5, 4.4)


def test_without_a_score():
    """Results of an older version have none."""
    old = frame({0: (0.4, 1.0)})
    old = old[old["metric"] != "bias-z"]
    assert deciding_test(SimpleNamespace(frame=old), "m", "cosine", "s") is None
