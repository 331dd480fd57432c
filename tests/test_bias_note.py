"""A note on bias over several seeds names the test that it stands on."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from harness.analysis.bias import deciding_test
from harness.analysis.results import Results


def results(tests, lost=(), without=()):
    """Of the measure: a p-value, a score and whether the tail is resolved, for every seed."""
    frame = pd.DataFrame(
        {"measure": "equal-spp", "material": "m", "method": "cosine", "scene": "s",
         "seed": seed, "metric": metric, "value": value, "status": "ok", "reason": "",
         "trial": f"seed-{seed}"}
        for seed, (p, z) in tests.items()
        for metric, value in (
            ("bias-p", p), ("bias-z", z), ("tail-resolved", float(seed not in lost))
        )
    )  # fmt: skip
    return Results(Path(), frame[~frame["metric"].isin(without)], {"trials": []})


def test_the_score_is_that_of_the_p_value():
    """Scores of other seeds, which may have the other sign, do not count."""
    tests = {0: (0.4, -0.8), 3: (1e-5, 4.4), 7: (0.2, -1.3)}
    found = deciding_test(results(tests), "m", "cosine", "s")
    assert (found.seed, found.seeds, found.p, found.z) == (3, 3, 1e-5, 4.4)


def test_a_seed_whose_tail_is_not_resolved_does_not_decide():
    found = deciding_test(results({0: (0.4, -0.8), 3: (1e-5, 4.4)}, lost=(3,)), "m", "cosine", "s")
    assert (found.seed, found.p) == (0, 0.4)


def test_without_a_score():
    """Results of an older version have none."""
    old = results({0: (0.4, 1.0)}, without=("bias-z",))
    assert deciding_test(old, "m", "cosine", "s") is None
