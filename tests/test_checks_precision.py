"""Checks of double precision and bfloat16."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from harness._methods.histogram import Histogram
from harness._methods.histogram_mixture import HistogramMixture
from harness._methods.improved_baseline import ImprovedBaseline
from harness._methods.tabulated import Tabulated
from harness.checks.finding import verdict
from harness.checks.precision import check_bfloat16, check_float64
from harness.checks.subject import Subject
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method
from harness.nets.extremes import held
from tests import planted
from tests.check_subjects import SEEDS, case, found, subject, worst

# --- precision ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "method",
    [
        planted.Correct,
        ImprovedBaseline,
        lambda: Histogram(resolution=8),
        lambda: HistogramMixture(levels=5, resolution=16, bases=3),
        lambda: Tabulated(resolution=32),
    ],
    ids=["correct", "improved-baseline", "histogram", "histogram-mixture", "tabulated"],
)
def test_float64_of_correct_adapters(method: Callable[[], Method], seed: int) -> None:
    checked = subject(method(), seed=seed)
    assert worst(check_float64, checked, case(checked, "grazing")) in ("pass", "skip")
    reference = checked.method.reference_pdf(*_somewhere(checked))
    if reference is not None:
        assert reference.dtype == torch.float64
        pdf = checked.method.pdf(*_somewhere(checked)).double()
        torch.testing.assert_close(reference, pdf, rtol=1e-4, atol=1e-9)


def _somewhere(checked: Subject) -> tuple[Tensor, Tensor]:
    """Conditions and directions off any edge of dyadic cells."""
    wo = torch.tensor([[0.1234, -0.377], [-0.711, 0.313], [0.911, 0.02], [1.03, 0.2]])
    return checked.material.conditions(4, torch.Generator().manual_seed(0)), wo


class Double(planted.Correct):
    """Has a reference: the same in double precision."""

    def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        wi, stretch = condition.double()[:, -2:], self.stretch.double()
        centres = torch.stack([-stretch * wi, wi.flip(-1) * 0.5], 1)
        off = (wo.double()[:, None] - centres) / torch.tensor(self.sigmas).double()[:, None]
        norm = torch.tensor(self.weights[1:]) / (2 * math.pi * torch.tensor(self.sigmas) ** 2)
        lobes = (norm.double() * torch.exp(-0.5 * off.square().sum(-1))).sum(-1)
        return lobes + torch.where(inside_disk(wo), self.weights[0] / math.pi, 0)


class Cancels(Double):
    """(wo - c)^2 as wo^2 - 2 wo c + c^2, after a shift that costs three digits."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return (super().pdf(condition, wo) + 1e3) - 1e3


def test_float64_finds_cancellation() -> None:
    checked = subject(Double())
    assert worst(check_float64, checked, case(checked)) == "pass"
    checked = subject(Cancels())
    finding = verdict(found(check_float64, checked, case(checked)))
    assert finding.verdict == "fail" and finding.number > 1e-5


def test_float64_skips_what_answers_in_single() -> None:
    checked = subject(planted.Correct())
    assert worst(check_float64, checked, case(checked)) == "skip"


class InHalf(planted.Correct):
    """Computes in whatever precision it is given."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        half = condition.dtype == torch.bfloat16
        pdf = super().pdf(condition, wo)
        return pdf.bfloat16() * self.error if half else pdf

    error = 1.0


class WrongInHalf(InHalf):
    """Twice the density for bfloat16."""

    error = 2.0


class NanInHalf(InHalf):
    """Overflows."""

    error = math.nan


class NetworkInHalf(ImprovedBaseline):
    """Runs its network in half precision for inputs in half: activations and weights of eight bits.

    Its lobes are as narrow as ``sigma``, so that a rounding of the mean moves the density much.
    """

    sigma = 0.1
    times = 1.0

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Through :meth:`log_prob`, which is plain torch."""
        if condition.dtype != torch.bfloat16:
            return super().pdf(condition, wo)
        half = copy.copy(self)
        half.module = copy.deepcopy(self.module).bfloat16()
        with torch.no_grad():
            return half.log_prob(condition, wo[:, None])[:, 0].exp() * self.times

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        """Directions that are handed on with eight bits, and the density there."""
        drawn = super().sample(condition, u)
        if condition.dtype != torch.bfloat16:
            return drawn
        wo = drawn.wo.bfloat16()
        return DiskSample(wo, self.pdf(condition, wo))

    def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> FitReport:
        """And all but one lobe forgotten, that one narrow."""
        report = super().fit(material, budget, generator)
        state = self.extremes()["uniform-to-0"]
        last = f"mlp.layers.{len(self.module.mlp.layers) - 1}"
        for output in self._roles()[0]:
            row = slice(output, output + 1)
            state = held(state, last, row, math.log(self.sigma))
        self.load_state_dict(state)
        return report


class NarrowInHalf(NetworkInHalf):
    """Most of its densities are off by more than a tenth, which half precision has to be."""

    sigma = 0.01


class WrongNetworkInHalf(NetworkInHalf):
    """Half too large, besides."""

    times = 1.5


class Refuses(planted.Correct):
    """Says what it wants."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        if condition.dtype != torch.float32:
            raise TypeError(f"expected float32, not {condition.dtype}")
        return super().pdf(condition, wo)


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        (planted.Correct, "pass"),
        (Refuses, "pass"),
        (lambda: Histogram(resolution=8), "pass"),
        (lambda: Tabulated(resolution=16), "pass"),
        (InHalf, "degraded"),
        (NetworkInHalf, "degraded"),
        (NarrowInHalf, "degraded"),
        (WrongNetworkInHalf, "fail"),
        (WrongInHalf, "fail"),
        (NanInHalf, "fail"),
    ],
)
def test_bfloat16(method: Callable[[], Method], expected: str) -> None:
    assert worst(check_bfloat16, subject(method())) == expected
