"""The properties of weights, tails, precision, gradients, batches, devices and inverses.

Each passes a correct adapter and finds a fault meant for it.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from harness._methods.histogram import Histogram
from harness._methods.histogram_mixture import HistogramMixture
from harness._methods.improved_baseline import ImprovedBaseline
from harness._methods.tabulated import Tabulated
from harness.checks import batches, devices
from harness.checks.edges import check_edges, check_outside
from harness.checks.finding import Finding
from harness.checks.gradients import check_gradients, watched_gradients
from harness.checks.invertible import check_invertible
from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import DiskSample, Method
from harness.fitting.module_method import ModuleMethod
from tests import planted
from tests.check_subjects import SEEDS, Bump, case, found, subject, worst

# --- edges -------------------------------------------------------------------------------------


class RootOutside(planted.Correct):
    """The root of a negative number off the disk."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return super().pdf(condition, wo) + 0 * (1 - wo.square().sum(-1)).sqrt()


class ClosedOnBothSides(planted.Correct):
    """Cells that all contain their edges: an edge counts twice."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        pdf = super().pdf(condition, wo)
        return torch.where((wo[:, 0] * 16).frac() == 0, 2 * pdf, pdf)


class OpenOnBothSides(planted.Correct):
    """Cells none of which contains its edges."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return torch.where(wo[:, 1] == 0, 0.0, super().pdf(condition, wo))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    "method",
    [
        planted.Correct,
        lambda: Histogram(resolution=8),
        lambda: HistogramMixture(levels=5, resolution=16, bases=5),
        lambda: Tabulated(resolution=16),
    ],
    ids=["correct", "histogram", "histogram-mixture", "tabulated"],
)
def test_edges_of_correct_adapters(method: Callable[[], Method], seed: int) -> None:
    checked = subject(method(), seed=seed)
    assert worst(check_edges, checked) == "pass"
    assert worst(check_outside, checked) == "pass"


def test_wrong_edges_fail() -> None:
    assert worst(check_outside, subject(RootOutside())) == "fail"
    assert worst(check_edges, subject(ClosedOnBothSides())) == "fail"
    assert worst(check_edges, subject(OpenOnBothSides())) == "fail"


class Fitted(ModuleMethod):
    """A Gaussian of fitted width on everything, by torch."""

    name = "fitted"

    def build(self, material: Material) -> nn.Module:
        return Bump()

    def radius(self, wo: Tensor) -> Tensor:
        return wo.square().sum(-1)

    def log_prob(self, condition: Tensor, wo: Tensor) -> Tensor:
        log = self.module.raw.sum()
        return -self.radius(wo) * torch.exp(-2 * log) / 2 - 2 * log - math.log(2 * math.pi)

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        raise AssertionError("not sampled")

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        raise AssertionError("not asked")


class KinkAtCentre(Fitted):
    """The square of a root, whose gradient at zero is 0 / 0."""

    def radius(self, wo: Tensor) -> Tensor:
        return wo.square().sum(-1).sqrt().square()


class RootInLoss(Fitted):
    """The loss has a root of zero."""

    def loss(self, *arguments: Any) -> Tensor:
        return (self.module.raw * 0).square().sum().sqrt()


def test_gradients_of_log_prob() -> None:
    checked = subject(Fitted())
    assert worst(check_gradients, checked, case(checked)) == "pass"
    checked = subject(KinkAtCentre())
    finding = found(check_gradients, checked, case(checked))[0]
    assert finding.verdict == "fail" and finding.worst["wo"] == "(0, 0)"
    checked = subject(planted.Correct())
    assert worst(check_gradients, checked, case(checked)) == "skip"


def test_gradients_of_a_fit() -> None:
    def watched(method: Method) -> Finding:
        with watched_gradients() as watch, contextlib.suppress(FloatingPointError):
            subject(method)
        return watch.finding(method)

    good = watched(Fitted())
    assert good.verdict == "pass" and "20 steps" in good.text
    bad = watched(RootInLoss())
    assert bad.verdict == "fail" and "module.raw" in bad.text and "step 0" in bad.text
    assert watched(planted.Correct()).verdict == "skip"


def test_the_watch_ends_with_its_block() -> None:
    with watched_gradients() as watch:
        pass
    subject(Fitted())
    assert watch.steps == 0


# --- large batches and devices -----------------------------------------------------------------


class PdfOfAFixedLaunch(planted.Correct):
    """``pdf`` fills at most 2^18 rows when it is called by itself."""

    inside = False

    def sample(self, condition: Tensor, u: Tensor) -> DiskSample:
        wo = self.draw(condition, u)
        return DiskSample(wo, super().pdf(condition, wo))

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        pdf = super().pdf(condition, wo)
        return torch.where(torch.arange(len(pdf)) < 1 << 18, pdf, 0)


class LosesTheLastRow(planted.Correct):
    """Pairs of rows; an odd one is left as it was."""

    def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
        wo = super().draw(condition, u, *share)
        if len(wo) > 1 << 18:
            wo[len(wo) // 2 * 2 :] = 0
        return wo


def test_half_a_million_rows() -> None:
    check = batches.check_half_million
    assert worst(check, subject(planted.Correct())) == "pass"
    for wrong in (planted.FixedLaunch, PdfOfAFixedLaunch, LosesTheLastRow):
        finding = found(check, subject(wrong()))[0]
        assert finding.verdict == "fail" and finding.worst


@pytest.mark.parametrize("resolution", [256, pytest.param(2048, marks=pytest.mark.slow)])
def test_half_a_million_rows_of_tables(resolution: int) -> None:
    """Memory and work go with the tables, not with rows times cells."""
    assert worst(batches.check_half_million, subject(Tabulated(resolution))) == "pass"


def test_devices() -> None:
    assert worst(devices.across, subject(planted.Correct()), "cpu") == "pass"
    assert worst(devices.across, subject(planted.LosesState()), "cpu") == "fail"
    if not torch.cuda.is_available():
        finding = devices.check_devices(subject(planted.Correct()))
        assert finding.verdict == "skip" and "CUDA" in finding.text


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA on this machine")
def test_devices_on_cuda() -> None:
    assert worst(devices.check_devices, subject(ImprovedBaseline())) == "pass"


# --- inverses ----------------------------------------------------------------------------------


class Flow(planted.Correct):
    """A Gaussian by Box and Muller, bent by a shear, with a share of the uniform disk."""

    share, sigma, bend = 0.01, 0.3, 0.7

    def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
        turn, radius = 2 * math.pi * u[:, 1], (-2 * torch.log1p(-u[:, 0])).sqrt()
        z = radius[:, None] * torch.stack([turn.cos(), turn.sin()], -1) * self.sigma
        x, y = z.unbind(-1)
        wo = torch.stack([x + self.bend * y.sin(), y], -1) - 0.5 * condition[:, -2:]
        return torch.where(u[:, 2:] < self.share, square_to_disk(u[:, :2]), wo)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        z = self.unbend(condition, wo)
        flow = torch.exp(-0.5 * z.square().sum(-1)) / (2 * math.pi * self.sigma**2)
        return (1 - self.share) * flow + torch.where(inside_disk(wo), self.share / math.pi, 0)

    def unbend(self, condition: Tensor, wo: Tensor) -> Tensor:
        x, y = (wo + 0.5 * condition[:, -2:]).unbind(-1)
        return torch.stack([x - self.bend * y.sin(), y], -1) / self.sigma

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        z = self.unbend(condition.double(), wo.double())
        radius = z.square().sum(-1)
        turn = torch.atan2(z[:, 1], z[:, 0]) / (2 * math.pi) % 1
        return torch.stack([-torch.expm1(-radius / 2), turn, torch.full_like(turn, 0.5)], -1)


class ForgetsBend(Flow):
    """Its inverse leaves the shear out."""

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        flat = copy.copy(self)
        flat.bend = 0.69
        return Flow.inverse(flat, condition, wo)


class HalfTheAngle(Flow):
    """The arc tangent of the ratio alone."""

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        u = super().inverse(condition, wo)
        return torch.cat([u[:, :1], u[:, 1:2] % 0.5, u[:, 2:]], 1)


class NanInverse(Flow):
    """Gives up far from the lobe."""

    def inverse(self, condition: Tensor, wo: Tensor) -> Tensor:
        u = super().inverse(condition, wo)
        return torch.where(u[:, :1] > 0.99, torch.nan, u)


@pytest.mark.parametrize("seed", SEEDS)
def test_inverse_of_a_flow(seed: int) -> None:
    checked = subject(Flow(), seed=seed)
    finding = found(check_invertible, checked, case(checked))[0]
    assert finding.verdict == "pass", finding.line() + finding.worst_line()


@pytest.mark.parametrize("wrong", [ForgetsBend, HalfTheAngle, NanInverse])
def test_wrong_inverses_fail(wrong: type[Method]) -> None:
    checked = subject(wrong())
    assert worst(check_invertible, checked, case(checked)) == "fail"


def test_no_inverse_is_no_failure() -> None:
    checked = subject(planted.Correct())
    assert worst(check_invertible, checked, case(checked)) == "skip"
