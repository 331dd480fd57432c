"""The rational-quadratic spline: against zuko, its inverse, its slopes, its edges."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from zuko.transforms import MonotonicRQSTransform

from harness.core.columns.bridge import columns_of, tensor_of
from harness.nets import spline
from tests.flow_inputs import BELOW_ONE


def random_raw(seed: int, scale: float, n: int = 400, bins: int = 20) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.randn(n, spline.outputs(bins), generator=g) * scale


def corners(raw: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Knots and derivatives straight from their definition, in double precision."""
    raw = raw.double()
    bins = (raw.shape[-1] + 1) // 3
    m = spline.MINIMUM

    def knots(logits):
        size = 2 * (m + (1 - m * bins) * torch.softmax(logits, -1))
        return torch.cat([torch.zeros_like(size[:, :1]), size.cumsum(-1)], -1) - 1

    d = raw[:, 2 * bins :]
    d = m + torch.log1p(torch.exp(d / (1 + d.abs() / 1e3)) * math.expm1(1 - m))
    one = torch.ones_like(d[:, :1])
    return knots(raw[:, :bins]), knots(raw[:, bins : 2 * bins]), torch.cat([one, d, one], -1)


def zuko_spline(raw: torch.Tensor) -> MonotonicRQSTransform:
    """An independent spline through the same knots."""
    x, y, d = corners(raw)
    theirs = MonotonicRQSTransform(x[:, 1:], y[:, 1:], d[:, 1:-1], bound=1.0)
    theirs.horizontal, theirs.vertical, theirs.derivatives = x, y, d
    return theirs


def run(function, *inputs: torch.Tensor) -> torch.Tensor:
    """A column function of ``(raw, value)`` as a tensor, an output a column."""
    raw, value = inputs
    out = function(columns_of(raw), columns_of(value[:, None])[0])
    return tensor_of(*out, rows=len(value))


def unwarp_columns(raw, y):
    """``(x, y, dy/dx)``, the last two at the rounded ``x``."""
    x, b = spline.unwarp_columns(raw, y)
    return x, *spline.evaluate_columns(b, x)


@pytest.mark.parametrize("bins", [2, 3, 20])
@pytest.mark.parametrize("scale", [0.0, 1.0, 8.0])
def test_spline_agrees_with_zuko(bins, scale):
    raw = random_raw(1, scale, bins=bins)
    x = torch.empty(len(raw), dtype=torch.float64).uniform_(-1.2, 1.2)
    y, ladj = zuko_spline(raw).call_and_ladj(x)
    ours, slope = spline.warp(raw.double(), x)
    # zuko's slope goes to its boundary value outside, not to one; that is one here as well.
    torch.testing.assert_close(ours, y, rtol=1e-7, atol=1e-9)
    inside = x.abs() < 1
    torch.testing.assert_close(slope[inside], ladj[inside], rtol=1e-6, atol=1e-6)
    # zuko's own inverse cancels; its forward map is the reference for ours.
    back = zuko_spline(raw).call_and_ladj(spline.unwarp(raw.double(), y))[0]
    torch.testing.assert_close(back, y, rtol=1e-7, atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.floats(0, 200), st.sampled_from([2, 5, 20]))
def test_spline_inverts_in_double_precision(seed, scale, bins):
    raw = random_raw(seed, scale, 200, bins).double()
    x = torch.linspace(-1.1, 1.1, 200, dtype=torch.float64)
    y, log_slope = spline.warp(raw, x)
    assert torch.isfinite(log_slope).all()
    back = spline.unwarp(raw, y)
    # The inverse is as steep as exp(-log_slope): rounding of y is magnified by it.
    assert ((back - x).abs() <= 1e-13 * (10 + torch.exp(-log_slope) + 2e3)).all()
    assert ((spline.warp(raw, back)[0] - y).abs() <= 1e-9).all()


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.floats(0, 1e6))
def test_spline_columns_are_finite_monotone_and_consistent(seed, scale):
    raw = random_raw(seed, scale, 1, 20).expand(2001, -1).contiguous()
    y = torch.linspace(-1.2, 1.2, 2001)
    x, again, slope = run(unwarp_columns, raw, y).unbind(-1)
    assert torch.isfinite(x).all() and torch.isfinite(slope).all() and (slope > 0).all()
    assert (x.diff() >= -3e-7).all()
    forward = run(spline.warp_columns, raw, x)
    # A sample in the last bit of a bin may be found in its neighbour, up to 1000 times steeper.
    torch.testing.assert_close(forward[:, 0], again, rtol=0, atol=3e-4)
    assert ((forward[:, 0] - again).abs() <= 1e-6).float().mean() > 0.99
    assert ((forward[:, 1] - slope).abs() <= 1e-4 * slope).float().mean() > 0.99


def test_log_slope_is_the_autograd_jacobian():
    raw = random_raw(3, 2.0, 1)[0].double()
    x = torch.linspace(-1.3, 1.3, 41, dtype=torch.float64)
    jacobian = torch.autograd.functional.jacobian(
        lambda v: spline.warp(raw.expand(41, -1), v)[0], x
    )
    expected = jacobian.diagonal().log()
    torch.testing.assert_close(spline.warp(raw.expand(41, -1), x)[1], expected)
    assert jacobian.fill_diagonal_(0).abs().max() == 0


def test_gradients_are_finite_everywhere():
    raw = random_raw(4, 30.0).requires_grad_()
    x = torch.linspace(-3, 3, len(raw)).requires_grad_()
    y, log_slope = spline.warp(raw, x)
    (y.sum() + log_slope.sum()).backward()
    assert torch.isfinite(raw.grad).all() and torch.isfinite(x.grad).all()


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_spline_twins_agree(scale):
    raw = random_raw(5, scale, 4000)
    x = torch.empty(4000).uniform_(-1.1, 1.1)
    y, log_slope = spline.warp(raw.double(), x.double())
    ours = run(spline.warp_columns, raw, x).double()
    # Knots are rounded to 1e-7, which a steep bin magnifies by its slope.
    assert ((ours[:, 0] - y).abs() <= 1e-6 * (1 + log_slope.exp())).float().mean() > 0.999
    error = (ours[:, 1] / log_slope.exp() - 1).abs()
    assert error.quantile(0.99) < 1e-4 * scale


def test_zeros_are_the_identity():
    x = torch.linspace(-1.5, 1.5, 301)
    out = run(spline.warp_columns, torch.zeros(301, 59), x)
    torch.testing.assert_close(out[:, 0], x, rtol=0, atol=3e-7)
    torch.testing.assert_close(out[:, 1], torch.ones(301), rtol=2e-6, atol=0)


@pytest.mark.parametrize("function", [spline.warp_columns, unwarp_columns])
def test_edges(function):
    raw = random_raw(6, 3.0, 6)
    near = torch.tensor([-1.0, 1.0, -BELOW_ONE, BELOW_ONE, -1.5, 7e4])
    out = run(function, raw, near)
    torch.testing.assert_close(out[:, 0], near, rtol=0, atol=2e-4)
    outside = near.abs() >= 1
    assert (out[outside, 0] == near[outside]).all() and (out[outside, -1] == 1).all()
    # Continuous slope: the last bit inside has nearly the slope outside.
    torch.testing.assert_close(out[:, -1], torch.ones(6), rtol=0.02, atol=0)


def test_slope_is_continuous_across_knots():
    raw = random_raw(7, 1.0, 500)
    x, y, d = corners(raw)
    for k in range(1, 20):
        for side in (-1, 1):
            at = x[:, k].float() * (1 + side * 2**-23)
            out = run(spline.warp_columns, raw, at).double()
            torch.testing.assert_close(out[:, 0], y[:, k], rtol=0, atol=1e-5)
            assert ((out[:, 1] - d[:, k]).abs() / d[:, k]).quantile(0.9) < 1e-3
