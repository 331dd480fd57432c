"""Bias tests of a run taken together: z-tests of mean images, corrected for their number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from harness.analysis.results import SHOWN, Results
from harness.analysis.validity import in_few_words
from harness.stats.ztest import holm

LEVEL = 0.05
"""Chance that any unbiased method at all is called biased, over the whole table."""
MEASURE = "equal-spp"

Key = tuple[str, str, str]
"""(material, method label, scene)"""


def corrected_p(results: Results) -> dict[Key, float]:
    """Holm-corrected p-values of all tests stored; the smallest over seeds for each cell.

    Without those of :func:`undecided`.
    """
    rows = results.frame
    rows = rows[(rows["measure"] == MEASURE) & (rows["metric"] == "bias-p")]
    rows = rows[rows["status"].isin(SHOWN) & rows["value"].notna()]
    rows = rows[~rows["trial"].isin(results.once(_unresolved))]
    keys = list(zip(rows["material"], rows["method"], rows["scene"], strict=True))
    corrected: dict[Key, float] = {}
    for key, p in zip(keys, holm(rows["value"]), strict=True):
        corrected[key] = min(float(p), corrected.get(key, 1.0))
    return corrected


def undecided(results: Results, material: str, method: str, scene: str) -> str:
    """Why no test decides about a cell; "" if one does.

    The test takes a render's mean for normal. Where the tail of its terms is not resolved, rare
    heavy samples hold a part of the mean: renders without them differ from the reference, however
    right the method is.
    """
    keys = {row["trial"] for row in results.rows(MEASURE, material, method, scene)}
    unresolved = results.once(_unresolved)
    if not keys or not keys <= unresolved.keys():
        return ""
    return f"not decided: {unresolved[min(keys)]}"


def _unresolved(results: Results) -> dict[str, str]:
    """Trials of the measure with a tail that is not resolved, and what is known of it."""
    rows = results.frame
    rows = rows[(rows["measure"] == MEASURE) & (rows["metric"] == "tail-resolved")]
    rows = rows[rows["value"] == 0]
    return dict(zip(rows["trial"], map(in_few_words, rows["reason"]), strict=True))


@dataclass(frozen=True)
class DecidingTest:
    """One of several seeds' tests: that of the smallest p-value."""

    seed: int
    seeds: int
    p: float
    z: float


def deciding_test(results: Results, material: str, method: str, scene: str) -> DecidingTest | None:
    """The test that a cell of several seeds is called biased by; None if there is no score.

    A mean of scores over seeds would not go with the smallest p-value.
    """
    rows = results.frame
    rows = rows[(rows["measure"] == MEASURE) & (rows["material"] == material)]
    rows = rows[(rows["method"] == method) & (rows["scene"] == scene)]
    rows = rows[rows["status"].isin(SHOWN)]
    rows = rows[~rows["trial"].isin(results.once(_unresolved))]
    metrics = rows.pivot_table(index="seed", columns="metric", values="value")
    if not {"bias-p", "bias-z"} <= set(metrics.columns):
        return None
    metrics = metrics.dropna(subset=["bias-p", "bias-z"])
    seed = metrics["bias-p"].idxmin()
    p, z = (float(metrics[key][seed]) for key in ("bias-p", "bias-z"))
    return DecidingTest(int(seed), len(metrics), p, z)


def bias_warnings(results: Results) -> Callable[[str, str, str], str]:
    """(material, method, scene) -> the warning to put on a speed-up; "" if unbiased."""
    corrected = corrected_p(results)

    def warning(material: str, method: str, scene: str) -> str:
        if corrected.get((material, method, scene), 1.0) >= LEVEL:
            return ""
        return (
            "biased: the mean image differs from the reference by more than noise (table of bias)"
        )

    return warning
