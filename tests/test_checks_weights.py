"""Checks of the weights f/p: mean, efficiency, tail index, energy that no sample finds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from harness.checks import peaks
from harness.checks.reflectance_points import resampled
from harness.checks.weights import check_weights
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.material import Material
from harness.core.protocol.method import Budget, Method
from harness.materials import registry as materials
from harness.materials.hard.flat import BrightPixel
from harness.stats.weights import bernstein, choose_cap, efficiency, hill
from tests import planted
from tests.check_subjects import LEVEL, SEEDS, Even, case, found, subject


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
