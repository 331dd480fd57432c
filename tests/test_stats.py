"""Statistics on synthetic data whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from harness.stats.cells import Cells
from harness.stats.chisquare import chi_square, sidak
from harness.stats.divergence import (
    chi_square_divergence,
    kl_divergence,
    lost_share,
    mean_squared_error,
)
from harness.stats.intervals import (
    geometric_mean,
    geometric_mean_of,
    interval_of_draws,
    mean_interval,
    median_interval,
    ratio_of_means,
    ratio_of_medians,
    speed_up,
)
from harness.stats.log_estimate import log_mean
from harness.stats.moments import one_sample_variance, variance_from_batches
from harness.stats.ztest import agreement, holm


def skewed(rng: np.random.Generator, n: int) -> np.ndarray:
    """Like variance estimates: positive, mean 1, coefficient of variation 0.5."""
    return rng.gamma(4, 0.25, n)


def test_the_interval_of_draws_is_their_percentiles():
    rng = np.random.default_rng(0)
    for shape in ((4001,), (7, 50), (3, 2, 41)):
        draws = rng.normal(size=shape)
        expected = np.percentile(draws, [2.5, 97.5], axis=-1)
        np.testing.assert_allclose(interval_of_draws(draws), expected, rtol=1e-12)
    far = np.where(np.arange(100) < 50, 1.0, np.inf)
    assert interval_of_draws(far).tolist() == [1.0, np.inf]
    far[7] = np.nan
    assert np.isnan(interval_of_draws(far)).all()


class TestMoments:
    def test_agrees_with_the_samples(self) -> None:
        x = np.random.default_rng(0).normal(3, 2, (50, 4))
        found = one_sample_variance(x.mean(0), (x**2).mean(0), 50)
        assert found == pytest.approx(x.var(0, ddof=1))

    def test_from_batches_is_unbiased(self) -> None:
        x = np.random.default_rng(1).normal(0, 2, (4000, 16, 10)).mean(2)
        found = [variance_from_batches(batch, 10) for batch in x]
        assert np.mean(found) == pytest.approx(4, rel=0.05)

    def test_one_sample_has_no_variance(self) -> None:
        with pytest.raises(ValueError, match="two samples"):
            one_sample_variance(1.0, 1.0, 1)


def coverage(draw, truth: float, trials: int = 500) -> float:
    """Share of intervals that hold the truth; its own standard error is 1 % at 95 %."""
    rng = np.random.default_rng(7)
    held = 0
    for trial in range(trials):
        found = draw(rng, trial)
        held += found.low <= truth <= found.high
    return held / trials


@pytest.mark.slow
class TestCoverage:
    """95 % intervals hold the truth 95 % of the time, within the noise of 500 trials.

    Of inputs that are skewed otherwise than those of test_stats_coverage.
    """

    @pytest.mark.parametrize("n", [8, 12])
    def test_ratio_of_means(self, n: int) -> None:
        def draw(rng, k):
            return ratio_of_means(skewed(rng, n), skewed(rng, n), seed=k)

        assert 0.925 < coverage(draw, 1) < 0.985

    def test_paired_ratio(self) -> None:
        def draw(rng, k):
            common = rng.lognormal(0, 0.5, 12)
            a, b = skewed(rng, 12) * common, skewed(rng, 12) * common
            return ratio_of_means(a, b, paired=True, seed=k)

        assert 0.925 < coverage(draw, 1) < 0.985

    def test_mean(self) -> None:
        normal = coverage(lambda rng, k: mean_interval(rng.normal(1, 0.1, 12), k), 1)
        assert 0.925 < normal < 0.985
        assert 0.915 < coverage(lambda rng, k: mean_interval(skewed(rng, 12), k), 1) < 0.985

    @pytest.mark.parametrize("n", [9, 16])
    def test_median(self, n: int) -> None:
        found = coverage(lambda rng, k: median_interval(rng.lognormal(0, 1, n)), 1, 1500)
        assert 0.93 < found < 0.975

    def test_speed_up(self) -> None:
        def draw(rng, k):
            times = 1 + 0.05 * rng.standard_normal((2, 8))
            return speed_up(skewed(rng, 8), skewed(rng, 8), *times, seed=k)

        assert 0.925 < coverage(draw, 1) < 0.99

    def test_geometric_mean_of_measured_ratios(self) -> None:
        def draw(rng, k):
            one = np.random.default_rng(k)
            parts = [log_mean(skewed(rng, 8), one) - log_mean(skewed(rng, 8), one) for _ in "abc"]
            return geometric_mean_of(parts)

        assert 0.925 < coverage(draw, 1, 300) < 0.99


class TestIntervals:
    def test_same_seed_same_interval(self) -> None:
        a, b = np.random.default_rng(0).gamma(4, 1, (2, 10))
        assert ratio_of_means(a, b, seed=3) == ratio_of_means(a, b, seed=3)
        assert ratio_of_means(a, b, seed=3) != ratio_of_means(a, b, seed=4)

    def test_ratio_and_its_reciprocal_mirror(self) -> None:
        a, b = np.random.default_rng(0).gamma(4, 1, (2, 10))
        there, back = ratio_of_means(a, b), ratio_of_means(b, a)
        # The same interval, but for the resamples; each value is unbiased on its own scale,
        # and 1 / x of an unbiased x is not.
        assert there.low * there.high == pytest.approx(1 / (back.low * back.high))
        assert there.high / there.low == pytest.approx(back.high / back.low, rel=0.1)
        assert there.low < there.value < there.high
        assert 1 > there.value * back.value > 0.9

    def test_equal_values_have_no_width(self) -> None:
        assert mean_interval([2.0] * 8) == pytest.approx((2, 2, 2))
        assert ratio_of_means([2.0] * 8, [1.0] * 8) == pytest.approx((2, 2, 2))
        assert speed_up([2.0] * 8, [1.0] * 8, [3.0] * 6, [1.0] * 6) == pytest.approx((6, 6, 6))

    def test_few_values(self) -> None:
        assert math.isnan(mean_interval([1.0]).low)
        assert math.isnan(median_interval([1.0]).high)
        assert median_interval([3.0, 1.0, 2.0]) == (2, 1, 3)
        low, high = mean_interval([1.0, 1.1, 0.9])[1:]
        assert low < 0.9 < 1.1 < high

    def test_values_of_both_signs(self) -> None:
        x = np.random.default_rng(0).normal(0, 1, 50)
        assert tuple(mean_interval(x)[1:]) == pytest.approx(
            stats.t.interval(0.95, 49, x.mean(), stats.sem(x))
        )

    def test_infinite_divergence_stays_infinite(self) -> None:
        assert mean_interval([1.0, np.inf]) == (np.inf, np.inf, np.inf)

    def test_many_values_fit_in_memory(self) -> None:
        x = np.random.default_rng(0).gamma(4, 0.25, 3000)
        found = mean_interval(x)
        assert found.high - found.low == pytest.approx(2 * 1.96 * 0.5 / math.sqrt(3000), rel=0.1)

    def test_paired_rounds_cancel(self) -> None:
        slow = np.random.default_rng(0).lognormal(0, 1, 11)
        assert ratio_of_medians(2 * slow, slow) == pytest.approx((2, 2, 2))
        assert ratio_of_means(2 * slow, slow, paired=True) == pytest.approx((2, 2, 2))

    def test_geometric_mean(self) -> None:
        found = geometric_mean([1.0, 4.0, 16.0])
        assert found.value == pytest.approx(4)
        assert found.low * found.high == pytest.approx(16)

    def test_refuses_what_has_no_logarithm(self) -> None:
        with pytest.raises(ValueError, match="above zero, got 0"):
            ratio_of_means([1.0, 0.0], [1.0, 1.0])
        with pytest.raises(ValueError, match="no values"):
            mean_interval([])


def images(rng: np.random.Generator, draw, methods: int = 3, spp: int = 32):
    """Mean images and variances of the means, of ``spp`` samples a pixel."""
    x = draw(rng, (methods, 48, 48, spp))
    return x.mean(-1), x.var(-1, ddof=1) / spp


def lognormal(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Heavy-tailed, mean 1."""
    return rng.lognormal(-0.5, 1, shape)


class TestAgreement:
    def test_false_alarms(self) -> None:
        rng = np.random.default_rng(0)
        p = [a.p_value for _ in range(60) for a in agreement(*images(rng, lognormal))]
        assert np.mean(np.array(p) < 0.05) < 0.12
        assert min(holm(p)) > 1e-3

    def test_sees_a_small_bias_everywhere(self) -> None:
        means, variances = images(np.random.default_rng(1), lognormal)
        means[1] *= 1.03
        found = agreement(means, variances)
        assert found[1].p_value < 1e-5
        assert found[1].difference == pytest.approx(0.03, abs=4 * found[1].difference_error)

    def test_sees_a_local_difference(self) -> None:
        means, variances = images(np.random.default_rng(2), lognormal)
        means[0, :16, :16] *= 1.15
        means[0, 16:32, :16] *= 0.85
        found = agreement(means, variances)
        assert found[0].chi_square_p < 1e-5
        assert abs(found[0].scores[0, 0]) > 4 and abs(found[0].scores[1, 0]) > 4

    def test_only_masked_pixels_count(self) -> None:
        means, variances = images(np.random.default_rng(3), lognormal)
        mask = np.zeros((48, 48), bool)
        mask[8:40, 8:40] = True
        spoiled = means.copy()
        spoiled[:, ~mask] = np.nan
        inside = agreement(spoiled, variances, mask)
        assert all(np.isfinite(a.p_value) for a in inside)
        with pytest.raises(ValueError, match="finite"):
            agreement(spoiled, variances)

    def test_without_noise(self) -> None:
        same = agreement(np.ones((2, 32, 32)), np.zeros((2, 32, 32)))
        assert same[0].p_value == 1
        other = agreement(
            np.stack([np.ones((32, 32)), np.full((32, 32), 2)]), np.zeros((2, 32, 32))
        )
        assert other[0].p_value == 0

    def test_holm(self) -> None:
        assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
        assert holm([0.5, 0.9]) == pytest.approx([1, 1])
        assert len(holm([])) == 0


class TestChiSquare:
    def test_p_values_are_uniform(self) -> None:
        rng = np.random.default_rng(0)
        share = rng.dirichlet(np.full(60, 0.3))
        counts = rng.multinomial(3000, share, 400)
        p = [chi_square(row, 3000 * share).p_value for row in counts]
        assert stats.kstest(p, "uniform").pvalue > 1e-3

    def test_a_missing_lobe_fails_though_nothing_is_observed_there(self) -> None:
        expected = np.array([900.0, 50, 50])
        assert chi_square([1000, 0, 0], expected).p_value < 1e-6

    def test_pools_by_expected_counts_and_drops_none(self) -> None:
        expected = np.append(np.full(100, 0.11), 989)
        assert chi_square(np.append(np.zeros(100), 1000), expected).dof == 2
        lost = np.append(np.full(100, 0.5), 950)
        assert chi_square(lost, expected).p_value < 1e-6

    def test_negative_expected_noise_pools(self) -> None:
        found = chi_square([500, 500, 0], [499.0, 502.0, -1.0])
        assert found.dof == 1 and found.p_value > 0.5

    def test_variance_of_the_expectation_softens(self) -> None:
        sharp = chi_square([600, 400], [500, 500])
        soft = chi_square([600, 400], [500, 500], [1e4, 1e4])
        assert sharp.p_value < 1e-6 < soft.p_value

    def test_worst_cell(self) -> None:
        assert chi_square([100, 100, 300, 100], [150] * 4).worst == 2

    def test_sidak(self) -> None:
        assert 1 - (1 - sidak(0.01, 24)) ** 24 == pytest.approx(0.01)
        assert sidak(1e-18, 2) == pytest.approx(5e-19)


class TestCells:
    @settings(max_examples=25, deadline=None)
    @given(hnp.arrays(float, (40, 2), elements=st.floats(0, 1)))
    def test_cells_tile_the_square(self, points: np.ndarray) -> None:
        cells = Cells.uniform(1).refined(points, 3)
        assert (cells.side**2).sum() == pytest.approx(1)
        found = cells.find(points)
        corner, side = cells.corner[found], cells.side[found, None]
        inside = (points >= corner - 2e-7) & (points <= corner + side + 2e-7)
        assert inside.all()
        assert cells.count(points).sum() == 40

    def test_fine_where_points_are(self) -> None:
        points = np.random.default_rng(0).normal(0.3, 1e-3, (1000, 2))
        cells = Cells.uniform(2).refined(points, 20)
        assert cells.count(points).max() <= 20
        assert cells.side.min() < 1e-3 < 0.2 < cells.side.max()

    def test_refinement_knows_its_owner(self) -> None:
        coarse = Cells.uniform(2)
        fine = coarse.split(np.arange(16) % 3 == 0)
        sums = np.bincount(coarse.owner(fine), fine.side**2)
        assert sums == pytest.approx(np.full(16, 1 / 16))


class TestDivergence:
    def test_known_values(self) -> None:
        p_star, p = np.array([3.0, 1.0]), np.array([2.0, 2.0])
        assert kl_divergence(p_star, p, 0.25) == pytest.approx(
            0.25 * (3 * math.log(1.5) + math.log(0.5))
        )
        assert chi_square_divergence(p_star, p, 0.25) == pytest.approx((4.5 + 0.5) / 4 - 1)
        assert mean_squared_error(p_star, p) == 1

    def test_points_stand_for_what_they_say(self) -> None:
        """A cell cut in two changes nothing; a larger one counts for more."""
        p_star, p = np.array([3.0, 1.0]), np.array([2.0, 2.0])
        twice = np.array([3.0, 3.0, 1.0]), np.array([2.0, 2.0, 2.0]), np.array([0.1, 0.15, 0.25])
        for measure in (kl_divergence, chi_square_divergence, mean_squared_error, lost_share):
            assert measure(*twice) == pytest.approx(measure(p_star, p, 0.25))
        assert mean_squared_error([3.0, 2.0], [2.0, 2.0], [3.0, 1.0]) == 0.75
        assert lost_share([1.0, 1.0], [0.0, 1.0], [3.0, 1.0]) == 0.75

    def test_nothing_is_floored(self) -> None:
        p_star, p = np.array([[1.0, 1.0], [2.0, 0.0]]), np.array([[2.0, 0.0], [1.0, 0.0]])
        assert kl_divergence(p_star, p)[0] == np.inf
        assert chi_square_divergence(p_star, p)[0] == np.inf
        assert np.isfinite(kl_divergence(p_star, p)[1])
        assert lost_share(p_star, p) == pytest.approx([0.5, 0])

    def test_chi_square_is_the_variance_under_constant_light(self) -> None:
        rng = np.random.default_rng(0)
        p_star = rng.gamma(1, 1, 64)
        p = 0.9 * rng.gamma(2, 1, 64)
        p_star, p = p_star / p_star.mean() / math.pi, 0.9 * p / p.mean() / math.pi
        # 90 % of the samples are valid, the others' estimate is zero.
        weight = p_star / p
        mass = p * math.pi / 64
        variance = (mass * weight**2).sum() - (mass * weight).sum() ** 2
        assert chi_square_divergence(p_star, p) == pytest.approx(variance)

    @pytest.mark.parametrize("bad", [-1.0, np.nan])
    def test_no_density_no_divergence(self, bad: float) -> None:
        for measure in (kl_divergence, chi_square_divergence, mean_squared_error, lost_share):
            assert np.isnan(measure([0.5, 0.5], [1.0, bad]))
