"""The measures of the density: divergence over conditions, slices."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from harness.analysis.records.slices import divergences
from harness.fitting.targets import cells
from harness.materials.hard.lobes import Lobe, Lobes
from harness.mitsuba_runtime import variant
from tests.fakes import FakeMaterial
from tests.materials import Plain
from tests.measure_subjects import Nan, Still, Uneven, assert_same_bytes, measured, pdf, values

variant.use("cpu")


class Exact(Uneven):
    """The density of :class:`Still`, for what needs no samples of it."""

    name = "exact"

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        """See :meth:`Method.pdf`."""
        total = Still().target_grid(condition[:1], cells(256)[None]).mean() * math.pi
        return Still().target(condition, wo) / total


@pytest.mark.parametrize("share", [1.0, 0.5, 1.9])
def test_pdf_of_known_divergence(share):
    """On a Lambertian, by formula."""
    found = pdf(Uneven(share), FakeMaterial("grey"))
    assert found["kl"] == pytest.approx(-(math.log(share) + math.log(2 - share)) / 2, abs=1e-5)
    chi2 = (1 / share + 1 / (2 - share)) / 2 - 1
    assert found["chi2"] == pytest.approx(chi2, rel=1e-4, abs=1e-5)
    assert found["chi2-median"] == pytest.approx(chi2, rel=1e-4, abs=1e-5)
    assert found["mse"] == pytest.approx(((share - 1) / math.pi) ** 2, abs=1e-6)
    assert found["lost-share"] == found["invalid-share"] == 0
    assert found["black-conditions"] == found["negative-share"] == 0


def test_pdf_with_invalid_samples():
    """They are missing from the density, and counted."""
    found = pdf(Uneven(lost=0.25), FakeMaterial("grey"))
    assert found["kl"] == pytest.approx(math.log(4 / 3), abs=1e-5)
    assert found["chi2"] == pytest.approx(1 / 3, abs=1e-5)
    assert found["invalid-share"] == pytest.approx(0.25, abs=5 * math.sqrt(0.19 / 16 / 1024))
    assert found["lost-share"] == 0


def test_pdf_that_misses_light():
    """Infinite is what it is, with the share of light that is lost beside it."""
    found = pdf(Uneven(share=0), FakeMaterial("grey"))
    assert found["kl"] == found["chi2"] == found["chi2-median"] == math.inf
    assert found["lost-share"] == pytest.approx(0.5, abs=1e-6)
    assert found["mse"] == pytest.approx(1 / math.pi**2, rel=1e-5)


def test_pdf_without_a_density():
    """A nan of the method is no number of the measure."""
    with pytest.raises(FloatingPointError, match="nan: pdf is negative or not finite in"):
        pdf(Nan(), FakeMaterial("grey"))


@pytest.mark.parametrize("sigma", [0.1, 0.01, 0.002])
def test_a_narrow_peak_is_not_blurred(sigma):
    """The entropy of a Gaussian is known; a cell of 32 a side is fifteen times the last one."""

    class Spike(Lobes):
        base = 0.0

        def lobes(self, condition: Tensor) -> list[Lobe]:
            """See :meth:`Lobes.lobes`."""
            return [Lobe(1.0, sigma, 0.3 * condition[..., -2:])]

    found = pdf(Uneven(), Spike("spike", {}))
    assert found["kl"] == pytest.approx(math.log(0.5 / sigma**2) - 1, rel=0.004)


def test_pdf_of_the_target_itself():
    """Nothing but the quadrature's own noise."""
    found = pdf(Exact(), Still())
    assert abs(found["kl"]) < 2e-3 and abs(found["chi2"]) < 2e-3


def test_pdf_facts_of_the_material():
    """Black conditions have no p*; negative values are counted."""

    class Odd(FakeMaterial):
        def eval(self, condition: Tensor, wo: Tensor) -> Tensor:
            value = super().eval(condition, wo)
            value = torch.where(wo[:, 1:] < 0, -value, value)
            return torch.where(condition[:, :1] < 0, 0, value)

    outcome = measured("pdf", Uneven(), Odd("odd"), conditions=64, resolution=16)
    found = values(outcome)
    assert 16 < found["black-conditions"] < 48
    lit = 64 - int(found["black-conditions"])
    assert found["negative-share"] == pytest.approx(0.5 * lit / 64, abs=0.05)
    # |f| is the target, and |f| is constant.
    assert found["kl"] == pytest.approx(0, abs=1e-5)
    assert outcome.arrays["condition"].shape == (lit, 2)
    assert all(len(outcome.arrays[n]) == lit for n in ("kl", "chi2", "mse", "invalid-share"))
    assert (outcome.arrays["condition"][:, 0] >= 0).all()


def test_pdf_uses_the_same_conditions_for_all_methods():
    """So that their differences are theirs."""
    outcomes = [measured("pdf", m, Plain(), conditions=8) for m in (Uneven(), Uneven(0.3))]
    assert_same_bytes(*outcomes, names=("condition", "negative-share"))


# --- slices ----------------------------------------------------------------------------


def test_slices():
    """Pictures over [-1, 1]^2, y down the rows; nan off the disk and only there."""
    outcome = measured("slices", Uneven(0.5), Still(), count=2, grid=64)
    target, density = outcome.arrays["target"], outcome.arrays["pdf"]
    assert target.shape == density.shape == (2, 64, 64)
    axis = (np.arange(64) + 0.5) / 32 - 1
    x, y = np.meshgrid(axis, axis)
    off = np.hypot(x, y) >= 1
    for image in (target, density):
        assert np.isnan(image[:, off]).all() and np.isfinite(image[:, ~off]).all()
    assert np.nansum(target, (1, 2)) * (2 / 64) ** 2 == pytest.approx([1, 1])
    right = np.where(x > 0, 0.5, 1.5) / math.pi
    np.testing.assert_allclose(density[0][~off], right[~off], rtol=1e-5)
    row, column = np.unravel_index(np.nanargmax(target[0]), (64, 64))
    # Still's bump is at -0.8 * 0.25 on both axes.
    assert (axis[column], axis[row]) == pytest.approx((-0.2, -0.2), abs=2 / 64)
    assert outcome.arrays["condition"].shape == (2, 2)
    kl, mse = divergences(outcome.arrays)
    assert kl.shape == mse.shape == (2,) and (kl > 0.1).all()
    assert mse == pytest.approx(np.nanmean((target - density) ** 2, (1, 2)))
    assert values(outcome)["kl-mean"] == pytest.approx(kl.mean())


def test_sampled_points_follow_the_density_beside_them():
    arrays = measured("slices", Uneven(0.5), Still(), count=2, grid=8, samples=4000).arrays
    assert arrays["samples"].shape == (2, 4000, 2)
    cells = np.floor((arrays["samples"] + 1) * 4).astype(int)
    for points, density in zip(cells, arrays["pdf"], strict=True):
        right = (points[:, 0] >= 4).mean()
        expected = np.nansum(density[:, 4:]) / np.nansum(density)
        assert right == pytest.approx(expected, abs=5 * math.sqrt(0.25 / 4000) + 0.02)


def test_slices_have_one_target_for_all_methods():
    outcomes = [measured("slices", m, Still(), count=1, grid=16) for m in (Uneven(), Uneven(0.5))]
    assert_same_bytes(*outcomes, names=("target", "condition"))


def test_slices_of_the_target_itself():
    """Divergence near nothing; p* and p are one picture."""
    arrays = measured("slices", Exact(), Still(), count=1, grid=64).arrays
    assert abs(divergences(arrays)[0]).max() < 5e-3
    np.testing.assert_allclose(arrays["pdf"], arrays["target"], rtol=0.02)
