"""Folds, holes and their bias are found in maps that have them, and in no others."""

from __future__ import annotations

import copy
import math

import pytest
import torch

from harness.core import registry
from harness.core.protocol.errors import StateRefused
from harness.core.protocol.method import Budget
from harness.fitting.map_degree import FURTHEST, examine, winding
from harness.fitting.targets import cells
from tests.materials import Plain

PLAIN = Plain()
BUDGET = Budget(steps=60, conditions=64, directions=36, resolution=32, pool=128)


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def published():
    method = registry.make("reparameterised-published")
    method.fit(PLAIN, BUDGET, rng(0))
    return method


def rings(turns: int, radius: float = 1.0, points: int = 400) -> torch.Tensor:
    """A circle run through ``turns`` times; clockwise if negative."""
    turn = torch.arange(points) * (2 * math.pi * turns / points)
    return radius * torch.stack([turn.cos(), turn.sin()], -1)


@pytest.mark.parametrize("turns", [-2, -1, 1, 2, 3])
def test_winding_numbers(turns):
    at = torch.tensor([[0.0, 0.0], [0.3, -0.4], [1.3, 0.0], [0.9, 0.9], [0.0, -0.99]])
    expected = torch.tensor([turns, turns, 0, 0, turns])
    assert torch.equal(winding(rings(turns), at), expected)


def test_winding_of_an_eight():
    """Its halves are turned around in opposite directions."""
    turn = torch.arange(400) * (2 * math.pi / 400)
    eight = torch.stack([turn.sin(), turn.sin() * turn.cos()], -1)
    found = winding(eight, torch.tensor([[0.6, 0.0], [-0.6, 0.0], [0.0, 0.5]]))
    assert found[0] == -found[1] != 0 and found[2] == 0


# --- maps in closed form --------------------------------------------------------------


def of_squares(z):
    """z / sqrt(1 + |z|^2), which covers the disk once but for a rim of 1.5 %."""
    r2 = 1 + z.square().sum(-1)
    return z / r2[..., None].sqrt(), r2**-2


@pytest.mark.parametrize(
    ("change", "folded", "missed", "repeated", "bias"),
    [
        (lambda wo, det: (wo, det), 0, 0, 0, 0),
        (lambda wo, det: (wo * torch.tensor([1, -1]), -det), 1, 0, 1, -2),
        (lambda wo, det: (0.5 * wo, det / 4), 0, None, 0, None),
    ],
    ids=["one-to-one", "mirrored", "half"],
)
def test_closed_forms(change, folded, missed, repeated, bias):
    condition = PLAIN.conditions(6, rng(1))
    found = examine(lambda c, z: change(*of_squares(z)), PLAIN, condition, rng(2))
    assert found.folded == folded
    if missed is None:
        # Within half the radius there is less than half of a p* that is nowhere zero.
        assert found.missed > 0.2 and found.bias == pytest.approx(-found.missed, abs=1e-12)
    else:
        assert found.missed < 0.05 and found.repeated == pytest.approx(repeated, abs=0.05)
        assert found.bias == pytest.approx(bias, abs=0.05)


def test_the_square_of_the_plane_covers_twice():
    """z -> z^2 has degree two: every direction twice, half of it too bright by as much."""

    def squared(condition, z):
        wo, det = of_squares(z)
        x, y = z.unbind(-1)
        again, det = of_squares(torch.stack([x * x - y * y, 2 * x * y], -1))
        return again, det * 4 * (x * x + y * y)

    found = examine(squared, PLAIN, PLAIN.conditions(4, rng(3)), rng(4))
    assert found.folded == 0 and found.repeated > 0.99 and found.bias == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(("size", "seed"), [(0, 0), (0.3, 1), (0.8, 1), (0.8, 3)])
def test_the_bias_is_that_of_the_estimates(published, size, seed):
    """The mean of f det J / N over z, by quadrature, is the integral of f times the degree."""
    method = with_change(published, seed, "fold", size)
    condition = PLAIN.conditions(3, rng(5))
    found = examine(method.map, PLAIN, condition, rng(6), points=2048, resolution=64)
    n = 256
    r = (torch.arange(n) + 0.5) * (FURTHEST / n)
    turn = (torch.arange(n) + 0.5) * (2 * math.pi / n)
    z = (r[:, None, None] * torch.stack([turn.cos(), turn.sin()], -1)).reshape(1, -1, 2)
    area = r[:, None].expand(n, n).reshape(-1) * (FURTHEST / n) * (2 * math.pi / n)
    off = []
    for row in condition:
        with torch.no_grad():
            wo, det = method.map(row[None], z)
        f = PLAIN.target(row.expand(n * n, -1), wo[0])
        mean = float((f.double() * det[0] * area).sum())
        truth = float(PLAIN.target_grid(row[None], cells(256)[None]).double().mean()) * math.pi
        off.append(mean / truth - 1)
    assert sum(off) / len(off) == pytest.approx(found.bias, abs=8e-3)
    assert (found.folded > 0) == (size > 0.5)


# --- planted in a fitted state --------------------------------------------------------


def with_change(method, seed: int, what: str, size: float = 1.5):
    """The method with a fold or a hole planted, another one for each ``seed``."""
    other, g = copy.deepcopy(method), rng(seed)
    layers = other.module.map.layers
    with torch.no_grad():
        if what == "fold":
            # The last hidden layer sees something else, which bends the map over itself.
            layers[-2].weight.add_(size * torch.randn(layers[-2].weight.shape, generator=g))
        else:
            # The horizon is put out of reach on one side: half of the disk's circle has no z.
            turn = 2 * math.pi * torch.rand((), generator=g)
            layers[-1].weight[:2].mul_(0.25)
            layers[-1].bias[:2] = 0.8 * torch.stack([turn.cos(), turn.sin()])
            layers[-1].bias[2] += 1.0
    return other


def test_the_fit_as_it_is(published):
    report = published.report()
    assert report.folded == 0 and report.repeated == 0 and report.missed < 0.15


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("what", ["fold", "hole"])
def test_planted_faults_are_found(published, what, seed):
    method = with_change(published, seed, what)
    report = method.report()
    if what == "fold":
        assert report.folded > 0
    else:
        assert report.missed > 0.1 and report.bias < -0.1
    strict = registry.make("reparameterised-published", certified=True)
    strict.bind(PLAIN)
    with pytest.raises(StateRefused, match="state refused: .*expected no negative determinant"):
        strict.load_state_dict(method.state_dict())
    # As published, it loads, and says what it is.
    plain = registry.make("reparameterised-published")
    plain.bind(PLAIN)
    plain.load_state_dict(method.state_dict())
    assert plain.report() == report
