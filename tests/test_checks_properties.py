"""The properties of weights, tails, precision, gradients, batches, devices and inverses.

Each passes a correct adapter and finds a fault meant for it.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor, nn

from harness.checks import batches, devices, peaks
from harness.checks.edges import check_edges, check_outside
from harness.checks.finding import Finding, verdict
from harness.checks.gradients import check_gradients, watched_gradients
from harness.checks.invertible import check_invertible
from harness.checks.precision import check_bfloat16, check_float64
from harness.checks.reflectance_points import resampled
from harness.checks.subject import Case, Subject, cases
from harness.checks.tail import binomial, check_tail
from harness.checks.weights import check_weights
from harness.core.protocol.disk import inside_disk, square_to_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, DiskSample, FitReport, Method
from harness.fitting.module_method import ModuleMethod
from harness.materials import registry as materials
from harness.materials.hard.flat import BrightPixel
from harness.nets.extremes import held
from harness.stats.weights import bernstein, choose_cap, efficiency, hill
from methods.histogram import Histogram
from methods.histogram_mixture import HistogramMixture
from methods.improved_baseline import ImprovedBaseline
from methods.tabulated import Tabulated
from tests import planted

LEVEL = 1e-5
SEEDS = range(4)
"""A correct adapter fails in one of these by chance with a probability below 1e-4 a property."""


class Spot(planted.Plaster):
    """A lobe of 0.003 radians around the mirror direction, and next to nothing elsewhere."""

    name = "spot"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """1e-4 and a Gaussian."""
        lobe = torch.exp(-0.5 * ((wo + condition[:, -2:]) / 0.003).square().sum(-1))
        return torch.where(inside_disk(wo), 1e-4 + lobe, 0)[:, None].expand(-1, 3)


class Black(planted.Plaster):
    """No reflection at all."""

    name = "black"

    def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
        """Zero."""
        return torch.zeros(len(wo), 3)


def subject(method: Method, material: Material | None = None, seed: int = 0) -> Subject:
    """``method`` fitted to ``material``."""
    material = planted.Plaster() if material is None else material
    blank, generator = copy.deepcopy(method), torch.Generator().manual_seed(seed)
    budget = Budget(steps=20, conditions=32, directions=16, resolution=16, pool=64)
    method.fit(material, budget, generator)
    return Subject(method, blank, material, "cpu", generator, seed)


def case(checked: Subject, name: str = "oblique") -> Case:
    """An ordinary condition."""
    return next(c for c in cases(checked.material, checked.generator, "cpu") if c.name == name)


def found(check: Callable[..., Any], *arguments: Any) -> list[Finding]:
    """What a check says, as a list."""
    result = check(*arguments)
    return [result] if isinstance(result, Finding) else list(result)


def worst(check: Callable[..., Any], *arguments: Any) -> str:
    """The verdict of a check; a failure has to show its worst input or say what is wrong."""
    finding = verdict(found(check, *arguments))
    assert finding.verdict != "fail" or finding.worst or finding.text
    return finding.verdict


# --- statistics of weights ---------------------------------------------------------------------


@pytest.mark.parametrize("index", [1.3, 1.9, 3.0])
def test_hill_finds_the_index_of_pareto_weights(index: float) -> None:
    weight = stats.pareto.rvs(index, size=100_000, random_state=1)
    got, error = hill(weight, 1000)
    assert got == pytest.approx(index, abs=4 * error) and error < 0.05 * index


def test_hill_of_equal_weights_is_infinite() -> None:
    assert hill(np.ones(1000), 10)[0] == math.inf
    assert hill(np.array([0.0, 1.0]), 10)[0] == math.inf


def test_efficiency_of_lognormal_weights() -> None:
    weight = stats.lognorm.rvs(0.8, size=400_000, random_state=2)
    assert efficiency(weight) == pytest.approx(math.exp(-(0.8**2)), rel=0.03)
    assert efficiency(weight * 1e200) == pytest.approx(efficiency(weight))
    assert efficiency(np.ones(5)) == 1


def test_bernstein_holds_for_a_tail_without_variance() -> None:
    """Capped Pareto weights of index 1.2: broken no more often than the level of 0.05 says."""
    n, level, rng = 4000, 0.05, np.random.default_rng(3)
    broken = 0
    for _ in range(200):
        cap = choose_cap(rng.pareto(1.2, 1000) + 1, n, level, 0.2)
        v = np.minimum(rng.pareto(1.2, n) + 1, cap)
        # E[min(w, c)] = 1 + integral of P(w > t) from 1 to c.
        expected = 1 + (1 - cap**-0.2) / 0.2
        broken += abs(v.mean() - expected) > bernstein(v.var(ddof=1), cap, n, level)
    assert broken <= stats.binom.isf(1e-4, 200, level)


def test_cap_is_twice_the_largest_of_tame_weights_and_lower_of_wild_ones() -> None:
    tame = np.random.default_rng(0).random(1000)
    assert choose_cap(tame, 10**5, 1e-5, 0.05) == 2 * tame.max()
    wild = np.random.default_rng(0).pareto(0.7, 1000) + 1
    cap = choose_cap(wild, 10**5, 1e-5, 0.05)
    assert 1 < cap < wild.max()
    assert choose_cap(np.zeros(8), 100, 1e-5, 0.05) == 0


def test_cap_keeps_the_weights_that_matter() -> None:
    """Seven of a hundred weights have all of the mean, which can be resolved to 6 %, not to 2 %."""
    weight = np.where(np.random.default_rng(0).random(1 << 15) < 0.07, 2.0, 1e-8)
    n, level = 1 << 17, 1e-6
    assert 0.02 < bernstein(weight.var(), 2.0, n, level) / weight.mean() < 0.06
    assert choose_cap(weight, n, level, 0.02) == pytest.approx(2.0)


def test_resampled_in_proportion() -> None:
    share = np.array([1.0, 0.0, 3.0] * 1000)
    chosen = resampled(share, np.random.default_rng(0))
    assert not (share[chosen] == 0).any()
    assert (share[chosen] == 3).mean() == pytest.approx(0.75, abs=0.01)


# --- weights -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("wanted", [planted.Correct, planted.Bare])
def test_weights_of_a_correct_adapter(wanted: type[Method], seed: int) -> None:
    checked = subject(wanted(), seed=seed)
    names = {f.property: f for f in found(check_weights, checked, case(checked), LEVEL)}
    assert set(names) == {"weights", "largest-weight", "tail-index", "invalid"}
    assert not [f.line() for f in names.values() if not f.ok]
    assert 0 < names["weights"].number <= 1
    if wanted is planted.Correct:
        assert {f.verdict for f in names.values()} == {"pass"}


class TooLarge(planted.Correct):
    """Its density is 8 % too large."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return 1.08 * super().pdf(condition, wo)


class Drops(planted.Correct):
    """Samples whose weight is above the mean's double are thrown away."""

    def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
        wo = super().draw(condition, u, *share)
        weight = self.material.target(condition, wo) / self.pdf(condition, wo)
        return torch.where((weight > 0.4)[:, None], wo + 3, wo)


class Zero(planted.Correct):
    """No density for a tenth of its samples."""

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return torch.where(wo[:, 0] > 0.3, 0.0, super().pdf(condition, wo))


@pytest.mark.parametrize("wrong", [TooLarge, Drops, Zero])
def test_wrong_weights_fail(wrong: type[Method]) -> None:
    checked = subject(wrong())
    bad = [f for f in found(check_weights, checked, case(checked, "steep"), LEVEL) if not f.ok]
    assert [f.property for f in bad] == ["weights"] and bad[0].worst


class Even(planted.Correct):
    """The uniform disk."""

    weights = (1.0, 0.0, 0.0)

    def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
        return square_to_disk(u[:, 1:])


def test_uniform_on_a_spot_is_degraded_by_its_efficiency() -> None:
    """Chi-square divergence by hand: E = (int f)^2 / (pi int f^2)."""
    checked = subject(Even(), Spot())
    findings = {f.property: f for f in found(check_weights, checked, case(checked), LEVEL)}
    whole = 1e-4 * math.pi + 2 * math.pi * 0.003**2
    square = 1e-8 * math.pi + 2e-4 * 2 * math.pi * 0.003**2 + math.pi * 0.003**2
    assert findings["weights"].verdict == "degraded"
    assert findings["weights"].number == pytest.approx(whole**2 / (math.pi * square), rel=0.5)
    assert findings["largest-weight"].number > 100


def test_energy_that_is_never_sampled_is_degraded() -> None:
    """p > 0 everywhere, but one lobe that half of the energy is in has 1e-20 of the samples."""

    class Misses(planted.Correct):
        weights = (1e-20, 1.0, 0.0)
        sigmas = (0.1, 0.1)

        def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
            return super().draw(condition, u, self.weights)

    checked = subject(Misses())
    finding = found(check_weights, checked, case(checked), LEVEL)
    weights = next(f for f in finding if f.property == "weights")
    assert weights.verdict == "degraded" and "above" in weights.text


@pytest.mark.parametrize("seed", SEEDS)
def test_a_peak_that_no_sample_finds_is_degraded_with_its_number(seed: int) -> None:
    """Uniform samples, by hand: E[w]^2 / E[w^2] = (int f)^2 / (pi int f^2), a millionth.

    Of 2^17 samples a seventh of all seeds finds the pixel, and the others would see 1.
    """
    pixel = materials.make("bright-pixel")
    checked = subject(Even(), pixel, seed)
    at = case(checked)
    findings = {f.property: f for f in found(check_weights, checked, at, LEVEL)}
    area, base, bright = BrightPixel.WIDTH**2, BrightPixel.BASE, BrightPixel.BRIGHT
    square = (math.pi - area) * base**2 + area * (base + bright) ** 2
    expected = float(pixel.albedo(at.row[None])) ** 2 / (math.pi * square)
    assert findings["weights"].verdict == "degraded"
    assert findings["weights"].number == pytest.approx(expected, rel=0.05)
    # The same reflectance without a name for the pixel: it takes luck to know of it.
    assert peaks.centres(pixel, at).shape == (2, 2) and peaks.centres(Black(), at).shape == (1, 2)


def test_points_around_peaks_have_their_density() -> None:
    """Shares within rings in closed form, and what lies outside them by the density."""
    at = torch.tensor([[0.3, -0.2], [-1.1, 0.5]], dtype=torch.float64)
    n = 1 << 16
    wo = peaks.draw(at, n, np.random.default_rng(0))
    for edge in (1e-5, 1e-3, 0.1, 0.7):
        near = (wo - at[0]).norm(dim=1) < edge
        share = math.log(edge / peaks.NEAREST) / math.log(peaks.FARTHEST / peaks.NEAREST) / 2
        # From the other peak, a distance of 1.57, comes about its density times the area.
        far = float(peaks.density(at[1:], at[:1])) / 2 * math.pi * edge**2
        allowed = 5 * math.sqrt(share / n) + 0.3 * far
        assert float(near.double().mean()) == pytest.approx(share + far, abs=allowed)
    # Monte Carlo of 1 over the square [-4, 4]^2, in which all of it lies.
    random = torch.rand(1 << 18, 2, generator=torch.Generator().manual_seed(0)) * 8 - 4
    sure = ((random[:, None] - at).norm(dim=2) > 0.05).all(1)
    outer = (peaks.density(at, random) * sure).mean() * 64
    assert float(outer) == pytest.approx(
        float(((wo[:, None] - at).norm(dim=2) > 0.05).all(1).double().mean()), abs=0.02
    )


def test_a_tail_without_variance_is_degraded_and_two_levels_are_not() -> None:
    class Narrow(planted.Correct):
        """Gaussian of 0.12 on a bump of 0.2: the weights' index is 1 / (1 - .36) = 1.6."""

        weights = (0.0, 1.0, 0.0)
        sigmas = (0.12, 0.12)

        def fit(self, material: Material, budget: Budget, generator: torch.Generator) -> Any:
            report = super().fit(material, budget, generator)
            self.stretch = torch.tensor([1.0])
            return report

        def draw(self, condition: Tensor, u: Tensor, *share: Any) -> Tensor:
            return super().draw(condition, u, self.weights)

    class Bump(planted.Plaster):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            bump = torch.exp(-0.5 * ((wo + condition[:, -2:]) / 0.2).square().sum(-1))
            return torch.where(inside_disk(wo), bump, 0)[:, None].expand(-1, 3)

    checked = subject(Narrow(), Bump())
    at = case(checked, "normal")
    tail = next(f for f in found(check_weights, checked, at, LEVEL) if f.property == "tail-index")
    assert tail.verdict == "degraded"
    assert tail.number == pytest.approx(1 / (1 - 0.12**2 / 0.2**2), rel=0.05)

    class Step(planted.Plaster):
        """Forty times brighter on half of a hundredth of the disk."""

        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            value = torch.where(wo.square().sum(-1) < 0.005, 40.0, 1.0)
            return torch.where(inside_disk(wo), value, 0)[:, None].expand(-1, 3)

    checked = subject(Even(), Step())
    tail = [
        f for f in found(check_weights, checked, case(checked), LEVEL) if f.property == "tail-index"
    ]
    assert [f.verdict for f in tail] == ["pass"]


def test_black_material_has_no_weights() -> None:
    checked = subject(planted.Correct(), Black())
    findings = found(check_weights, checked, case(checked), LEVEL)
    assert {f.verdict for f in findings} == {"pass"}
    assert "black" in findings[-1].text


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


# --- gradients ---------------------------------------------------------------------------------


class Bump(nn.Module):
    """One number, and how its logarithm is taken."""

    def __init__(self) -> None:
        super().__init__()
        self.raw = nn.Parameter(torch.zeros(2))


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
