"""Raw data and numbers are apart: what measures give, and what records are made of."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.analysis.records import fit, registry, slices, stages
from harness.core.paths import ROOT
from harness.core.record import Raw
from harness.measures import registry as measures
from harness.measures.compact import single
from harness.stats.blocks import Blocks
from harness.stats.ztest import agreement, agreement_of_blocks

SHIPPED = sorted(set(measures.names()) - set(measures._EXTRA))
MEASURES, RECORDS = ROOT / "harness" / "measures", ROOT / "harness" / "analysis" / "records"


def imports(file: Path) -> set[str]:
    """All modules that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def test_every_measure_has_a_file_that_makes_its_records() -> None:
    assert registry.names() == SHIPPED
    assert registry.numbers("no-such-measure", Raw({})) is None


@pytest.mark.parametrize("file", sorted(MEASURES.glob("*.py")), ids=lambda file: file.stem)
def test_a_measure_gives_raw_data_alone(file: Path) -> None:
    """No record is made where it is measured, and nothing above a measure is imported."""
    above = [f"harness.{name}" for name in ("analysis", "report", "runner", "store", "suite")]
    for module in imports(file):
        assert not module.startswith(tuple(above)), module
    calls = [n for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.Call)]
    named = {node.func.id for node in calls if isinstance(node.func, ast.Name)}
    assert "Record" not in named
    given_ = {word.arg for node in calls for word in node.keywords}
    assert "records" not in given_


@pytest.mark.parametrize("file", sorted(RECORDS.glob("*.py")), ids=lambda file: file.stem)
def test_records_are_made_of_arrays_alone(file: Path) -> None:
    """By numpy, scipy, statistics and core: the same numbers wherever they are made again."""
    ours = ("harness.stats.", "harness.core.", "harness.analysis.")
    others = ("numpy", "scipy", "__future__", "collections", "dataclasses", "importlib", "math",
              "pathlib", "re", "types", "typing")  # fmt: skip
    for module in imports(file):
        assert module.startswith(ours) or module.partition(".")[0] in others, module


def test_what_is_missing_is_named() -> None:
    with pytest.raises(ValueError, match="slices: .* 'target'"):
        registry.numbers("slices", Raw({"pdf": np.ones((1, 4, 4))}))


# --- compact arrays ----------------------------------------------------------------------


@given(st.lists(st.floats(allow_subnormal=True), min_size=1))
def test_single_precision_loses_no_kind_of_number(values: list[float]) -> None:
    """What is finite stays finite, what is not zero stays so; six digits are kept."""
    exact = np.array(values)
    found = single(values)
    assert ((found == 0) == (exact == 0)).all()
    assert (np.isfinite(found) == np.isfinite(exact)).all()
    assert (np.isnan(found) == np.isnan(exact)).all()
    # Below single precision's normal range fewer digits are left.
    usual = np.isfinite(exact) & (np.abs(exact) > 1e-37)
    np.testing.assert_allclose(found[usual], exact[usual], rtol=1e-7)


def test_single_precision_where_it_is_enough() -> None:
    assert single([1.0, 0.0, math.inf]).dtype == np.float32
    assert single([1e300]).dtype == single([1e-300]).dtype == np.float64


# --- blocks ------------------------------------------------------------------------------


def images(seed: int, height: int = 40, width: int = 55) -> tuple[np.ndarray, ...]:
    """Mean [H, W], variance and mask of one image with noise of many sizes."""
    rng = np.random.default_rng(seed)
    variance = np.exp(rng.normal(size=(height, width)))
    mean = 3 + np.sqrt(variance) * rng.normal(size=variance.shape)
    mask = np.hypot(*(np.indices(variance.shape) - 20.0)) < 22
    return mean, variance, mask


def test_blocks_merge_to_those_of_the_pixels() -> None:
    mean, variance, mask = images(0)
    fine, coarse = (Blocks.of(mean, variance, mask, size) for size in (4, 16))
    for merged, direct in ((fine.merged(4), coarse), (fine.whole(), coarse.whole())):
        for a, b in zip(merged._parts(), direct._parts(), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12)
    whole = coarse.whole()
    assert whole.pixels == mask.sum() and whole.mean == pytest.approx(mean[mask].mean())
    assert whole.spread == pytest.approx(variance[mask].std())
    assert coarse.power == pytest.approx(np.square(mean[mask]).mean())
    again = Blocks.unpacked(coarse.pixels.astype(np.uint16), coarse.packed())
    for a, b in zip(again._parts(), coarse._parts(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_spread_of_nearly_equal_variances_is_kept() -> None:
    """No difference of large squares: relative 1e-9 is seen."""
    variance = 1 + 1e-9 * np.tile([-1.0, 1.0], (32, 16))
    found = Blocks.of(variance, variance, np.ones((32, 32), bool)).whole()
    assert found.spread == pytest.approx(1e-9, rel=1e-5)


def test_agreement_needs_the_blocks_alone() -> None:
    (a, va, mask), (b, vb, _) = images(1), images(2)
    whole = agreement([a, b], [va, vb], mask)[0]
    kept = [Blocks.of(a, va, mask), Blocks.of(b, vb, mask)]
    found = agreement_of_blocks(kept)[0]
    assert (found.p_value, found.difference) == (whole.p_value, whole.difference)
    with pytest.raises(ValueError, match="same pixels"):
        agreement_of_blocks([kept[0], Blocks.of(b, vb, ~mask)])
    with pytest.raises(ValueError, match="two images"):
        agreement_of_blocks(kept[:1])


def test_an_error_of_known_size_adds_to_the_variance() -> None:
    mean, variance, mask = images(3)
    found = Blocks.of(mean, variance, mask).uncertain(0.1).whole()
    wanted = Blocks.of(mean, variance + 0.01 * mean**2, mask).whole()
    assert found.variance == pytest.approx(wanted.variance)


@pytest.mark.parametrize(
    ("mean", "mask", "said"),
    [
        (np.ones((4, 5)), np.ones((4, 4), bool), "expected images"),
        (np.ones((4, 4)), np.zeros((4, 4), bool), "no pixel"),
        (np.full((4, 4), np.nan), np.ones((4, 4), bool), "finite"),
    ],
)
def test_what_is_no_image_is_refused(mean, mask, said) -> None:
    with pytest.raises(ValueError, match=said):
        Blocks.of(mean, np.ones((4, 4)), mask)


# --- records that no measure's own test asks for ------------------------------------------


def test_records_of_stages() -> None:
    """Per million rows; the bare network in its faster form."""
    arrays = {
        "stage-1": np.full(7, 0.2),
        "stage-2": np.full(7, 0.6),
        "bare": np.full(7, 0.4),
        "bare,-in-chunks": np.full(7, 0.3),
    }
    found = stages.numbers(Raw(arrays, settings={"rows": 500_000})).records
    assert {r.metric: r.value for r in found} == pytest.approx(
        {"stage-1-seconds": 0.4, "stage-2-seconds": 1.2, "bare-seconds": 0.6, "stage-2-ratio": 2.0}
    )


def test_a_fit_of_which_the_records_were_kept_gives_them_again() -> None:
    values = {"fit-seconds": 5.0, "data-seconds": 1.0, "optimise-seconds": 4.0}
    values |= {"load-seconds": 0.1, "parameters": 12.0, "size-bytes": 48.0}
    found = fit.numbers(Raw(fit.raw_of({**values, "final-loss": 0.5}))).records
    assert {r.metric: r.value for r in found} == values


@pytest.mark.parametrize(("elapsed", "waited"), [(5.2, 0.0), (6.1, 1.0)])
def test_a_fit_that_waited_for_a_processor_is_disturbed(elapsed: float, waited: float) -> None:
    arrays = fit.raw_of({"fit-seconds": elapsed, "optimise-seconds": elapsed})
    arrays |= {"elapsed_seconds": np.array(elapsed), "cpu_seconds": np.array(5.0)}
    found = fit.numbers(Raw(arrays))
    values = {r.metric: r.value for r in found.records}
    assert values["cpu-seconds"] == 5.0 and values["disturbed"] == waited
    assert found.reason == ("disturbed: of 6.1 s the fit had a processor for 5 s" if waited else "")


@pytest.mark.parametrize("n", [16, 17, 50])
def test_slices_are_compared_on_the_disk(n: int) -> None:
    axis = (np.arange(n) + 0.5) * 2 / n - 1
    inside = np.hypot(*np.meshgrid(axis, axis)) < 1
    rng = np.random.default_rng(n)
    target, pdf = (np.where(inside, rng.random((2, n, n)), np.nan) for _ in range(2))
    kl, mse = slices.divergences({"target": target, "pdf": pdf})
    log = np.log(target / pdf)
    assert kl == pytest.approx(np.nansum(target * log, (1, 2)) * (2 / n) ** 2)
    assert mse == pytest.approx(np.nanmean((target - pdf) ** 2, (1, 2)))
