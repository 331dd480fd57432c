"""The check of samples where the density is low."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from scipy import stats
from torch import Tensor

from harness.checks.subject import Case
from harness.checks.tail import binomial, check_tail
from harness.checks.weights import check_weights
from harness.core.protocol.method import DiskSample, Method
from tests import planted
from tests.check_subjects import LEVEL, SEEDS, Even, case, found, subject, worst

# --- the tail ----------------------------------------------------------------------------------


def test_binomial_is_scipys_without_error() -> None:
    mass, n = 3e-4, 1 << 17
    few = binomial(5, n, mass, 0.0, 1e-6)
    assert few == pytest.approx(2 * stats.binom.cdf(5, n, mass * (1 - 5e-4)) / 0.9)
    assert binomial(5, n, mass, 1e-4, 1e-6) > few
    assert binomial(39, n, mass, 0.0, 1e-6) == 1


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("wanted", [planted.Correct, planted.Bare, Even])
def test_tail_of_a_correct_adapter(wanted: type[Method], seed: int) -> None:
    checked = subject(wanted(), seed=seed)
    assert worst(check_tail, checked, case(checked), LEVEL) == "pass"


ROW = torch.tensor([[-0.3, 0.1]])


class Ridge(planted.Correct):
    """Of each 250 samples one lies in a strip so narrow that no cell's points fall into it.

    Most of the others are in the lobes, so that the strip's cells are among the lowest.
    """

    name = "ridge"
    weights = (0.08, 0.9, 0.02)
    # Sixteen numbers of single precision wide.
    share, left, width = 1 / 250, -0.625, 2.0**-20

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """Where the third uniform says so, x in the strip and y in [-0.5, 0.5)."""
        strip = torch.stack(
            [self.left + self.width * (16 * u[:, 0]).floor() / 16, u[:, 1] - 0.5], 1
        )
        there = u[:, 2:] < self.share
        rest = ((u[:, 2:] - self.share) / (1 - self.share)).clamp(min=0)
        around = self.draw(condition, torch.cat([u[:, :2], rest], 1), self.weights)
        wo = torch.where(there, strip, around)
        return DiskSample(wo, self.pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        x, y = wo.unbind(1)
        inside = (x >= self.left) & (x < self.left + self.width) & (y.abs() < 0.5)
        return (1 - self.share) * super().pdf(condition, wo) + inside * self.share / self.width


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ridge_that_no_point_falls_on_is_no_tail(monkeypatch: Any, seed: int) -> None:
    """Without a ceiling, samples are found where the estimated mass says there are none."""
    checked, at = subject(Ridge(), seed=seed), Case("lobes far from the strip", ROW)
    assert worst(check_tail, checked, at, LEVEL) == "pass"
    monkeypatch.setattr("harness.checks.tail.CEILING", math.inf)
    assert worst(check_tail, checked, at, LEVEL) == "fail"


@pytest.mark.parametrize("wrong", [planted.FloorsPdf, planted.ClampsTail])
@pytest.mark.parametrize("seed", [0, 1])
def test_wrong_tails_fail(wrong: type[Method], seed: int) -> None:
    checked = subject(wrong(), seed=seed)
    finding = found(check_tail, checked, case(checked), LEVEL)[0]
    assert finding.verdict == "fail" and {"wo", "got", "expected"} <= set(finding.worst)


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [planted.Correct, planted.Bare, Even])
def test_false_alarms_are_no_more_than_stated(wanted: type[Method]) -> None:
    """At a level of 0.1, in 100 seeds; the tests are conservative."""
    failed = {"tail": 0, "weights": 0}
    for seed in range(100):
        checked = subject(wanted(), seed=seed)
        at = case(checked)
        for check in (check_tail, check_weights):
            for finding in found(check, checked, at, 0.1):
                failed[finding.property] = failed.get(finding.property, 0) + (not finding.ok)
    limit = stats.binom.isf(1e-4, 100, 0.1)
    assert all(count <= limit for count in failed.values()), failed
