"""Importance maps: bijections of least cost, that reproduce the slice they were made of."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from harness.core.protocol.disk import square_to_disk
from harness.core.protocol.errors import InputError
from harness.importance_maps.hierarchical import Hierarchical
from harness.importance_maps.maps import KINDS, ImportanceMap, checked_kind, equal_points, make_map
from harness.importance_maps.quality import binned_error, coarse, gradients, histogram
from harness.importance_maps.row_column import RowColumn
from harness.importance_maps.slices import Slice, inner_share, slices_of
from harness.importance_maps.transport import cost, grid, transport
from harness.stats.chisquare import chi_square
from tests.materials import MATERIALS

LOBES = {
    "uniform": (9.0, 9.0, 0.0, 0.0),
    "broad": (0.6, 0.6, 0.2, 0.0),
    "oblique": (0.1, 0.3, 0.4, 0.3),
    "narrow": (0.06, 0.06, 0.7, 0.1),
    "rim": (0.1, 0.1, 0.7, 0.7),
}
lobes = pytest.mark.parametrize("lobe", LOBES)


def lobe_slice(name: str, n: int = 64, floor: float = 0.0) -> Slice:
    """A GGX-like lobe on the disk."""
    ax, ay, cx, cy = LOBES[name]
    x, y = np.meshgrid(*[(np.arange(n) + 0.5) * (2 / n) - 1] * 2)
    value = 1 / (1 + ((x - cx) / ax) ** 2 + ((y - cy) / ay) ** 2) ** 2 + floor
    return Slice((value * inner_share(n))[..., None] * np.array([0.9, 0.5, 0.2]))


# --- plans ---------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(side=st.integers(2, 9), seed=st.integers(0, 2**20))
@example(side=7, seed=142)  # unrefined 13 % above: no bound holds for a handful of points
def test_plan_is_a_bijection_near_the_optimum(side, seed):
    """Against an independent solver of the assignment problem."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(side * side, 2)) * rng.random(2)
    fine, fast = (transport(points, refine=refine) for refine in (True, False))
    for plan in (fine, fast):
        assert np.array_equal(np.sort(plan), np.arange(side * side))
    distance = np.square(grid(side)[:, None] - points[None]).sum(-1)
    rows, columns = linear_sum_assignment(distance)
    best = distance[rows, columns].mean()
    assert best * (1 - 1e-9) <= cost(points, fine) <= best * 1.01
    assert cost(points, fine) <= cost(points, fast) * (1 + 1e-9)


@lobes
def test_fast_plan_is_near_the_exact_one(lobe):
    """What it is off by falls with the number of points; 32^2 is for the speed of the test."""
    points = equal_points(lobe_slice(lobe), 32**2)
    exact, fast = (cost(points, transport(points, refine=e)) for e in (True, False))
    assert exact <= fast < 1.03 * exact


@pytest.mark.parametrize("refine", [True, False])
def test_points_on_the_grid_stay(refine):
    """Distances of zero are edges of the plan like all others."""
    points = grid(12)
    np.testing.assert_array_equal(transport(points, refine=refine), np.arange(144))
    shuffled = np.random.default_rng(1).permutation(144)
    assert cost(points[shuffled], transport(points[shuffled], refine=refine)) < (
        1e-20 if refine else 0.02
    )


def test_refused_numbers_of_points():
    with pytest.raises(ValueError, match="square number"):
        transport(np.zeros((10, 2)))
    with pytest.raises(InputError, match="did you mean 'row-column'"):
        checked_kind("row-colum", "here")


def test_transport_is_monotone():
    """The optimal map is the gradient of a convex function: no two cells gain by exchanging."""
    points = equal_points(lobe_slice("oblique"), 32**2)
    at, source = points[transport(points, refine=True)], grid(32)
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, 1024, (2, 20000))
    assert ((source[i] - source[j]) * (at[i] - at[j])).sum(1).min() > -1e-9


# --- maps ----------------------------------------------------------------------------------


@lobes
def test_transported_points_reproduce_the_slice(lobe):
    """Chi-square of the map's cells against the slice, which they fill more evenly than chance."""
    slice_, n = lobe_slice(lobe), 32
    wo = make_map(slice_, n).wo.reshape(-1, 2)
    assert (np.square(wo).sum(1) <= 1 + 1e-12).all()
    expected = coarse(slice_.mass, 16)
    found = histogram(wo, 16)
    test = chi_square(found * n * n, expected * n * n)
    assert test.statistic < test.dof / 2


@lobes
@pytest.mark.parametrize("sampler", [RowColumn, Hierarchical])
def test_random_points_follow_the_slice(lobe, sampler):
    """Chi-square of independent samples: the warp itself, without any grid."""
    slice_, n = lobe_slice(lobe, 32, floor=0.01), 1 << 16
    wo = sampler(slice_)(np.random.default_rng(1).random((n, 2)))
    test = chi_square(histogram(wo, 32) * n, slice_.mass * n)
    assert test.p_value > 1e-4
    # And off by 2 % it is found.
    tilted = slice_.mass * (1 + 0.02 * np.linspace(-1, 1, 32))
    assert chi_square(histogram(wo, 32) * n, tilted / tilted.sum() * n).p_value < test.p_value


def test_rim_is_filled_evenly():
    """The uniform disk comes out uniform up to its very edge: radius squared is uniform."""
    n = 64
    slice_ = Slice(np.repeat(inner_share(n)[..., None], 3, 2))
    wo = RowColumn(slice_)(np.random.default_rng(2).random((1 << 16, 2)))
    counts = np.histogram(np.square(wo).sum(1), np.linspace(0, 1, 65))[0]
    assert chi_square(counts, np.full(64, 1024.0)).p_value > 1e-4


@lobes
def test_interpolation_error_decreases(lobe):
    slice_ = lobe_slice(lobe)
    errors = [binned_error(make_map(slice_, n), slice_, 16, 256) for n in (8, 16, 32)]
    assert errors[2] < errors[1] < errors[0]


def test_transport_is_smoother_where_the_lobe_is_oblique():
    slice_ = lobe_slice("narrow", floor=0.01)
    worst = {k: np.quantile(gradients(make_map(slice_, 32, k)), 0.99) for k in KINDS}
    assert worst["optimal-transport"] < worst["row-column"]
    assert worst["optimal-transport"] < worst["hierarchical"]


def test_identity_has_the_gradient_of_the_identity():
    wo = grid(16).reshape(16, 16, 2)
    assert gradients(ImportanceMap(wo, wo[..., :1])) == pytest.approx(2 * math.sqrt(2))
    u = np.random.default_rng(0).random((50, 2)) * 0.9 + 0.05
    assert ImportanceMap(wo, wo).at(u) == pytest.approx(2 * u - 1)


# --- slices --------------------------------------------------------------------------------


def test_weight_is_f_over_p():
    """The mean weight is the albedo: sum of f over the disk, per channel."""
    slice_ = lobe_slice("oblique")
    albedo = slice_.rgb.sum((0, 1)) * (2 / 64) ** 2
    map_ = make_map(slice_, 32, "row-column")
    assert map_.weight.mean((0, 1)) == pytest.approx(albedo, rel=0.02)


def test_black_slice_is_refused():
    with pytest.raises(ValueError, match="black"):
        make_map(Slice(np.zeros((8, 8, 3))), 4)


@settings(max_examples=10, deadline=None)
@given(cut=st.integers(1, 3))
def test_slice_of_a_row_is_its_own(cut):
    """Whatever other rows are asked for; and its integral is the albedo."""
    material = MATERIALS["tilted"]()
    condition = material.conditions(4, torch.Generator().manual_seed(0))
    whole = slices_of(material, condition, 16, 3)
    assert torch.equal(slices_of(material, condition[:cut], 16, 3), whole[:cut])
    wo = square_to_disk(torch.rand(1 << 14, 2, generator=torch.Generator().manual_seed(1)))
    f = material.eval(condition[:1].expand(len(wo), -1), wo)
    expected = f.mean(0) * math.pi
    assert whole[0].sum((0, 1)) * (2 / 16) ** 2 == pytest.approx(expected, rel=0.05)
