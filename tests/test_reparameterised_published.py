"""The published map: its estimates, what it says of itself, and what a check finds."""

from __future__ import annotations

import math

import pytest
import torch

from harness.checks.run import run_checks
from harness.core import registry
from harness.core.protocol.disk import inside_disk
from harness.core.protocol.errors import InputError, StateRefused, Unsupported
from harness.core.protocol.method import Budget
from harness.fitting.reverse import normal_of_uniforms
from harness.materials import registry as materials
from tests.materials import HalfBlack, Plain, Tilted

NAME = "reparameterised-published"
BUDGET = Budget(steps=40, conditions=64, directions=36, resolution=32, pool=128)


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def fitted():
    method = registry.make(NAME)
    report = method.fit(Tilted(), BUDGET, rng(0))
    return method, report


def test_the_estimate_is_f_times_the_determinant_over_the_normal(fitted):
    method, _ = fitted
    condition, u = Tilted().conditions(500, rng(1)), torch.rand(500, 3, generator=rng(2))
    wo, pdf, weight = method.sample_weighted(condition, u)
    z = normal_of_uniforms(u[:, None, :2])
    with torch.no_grad():
        expected_wo, det = method.map(condition, z)
    normal = torch.exp(-0.5 * z.square().sum(-1)) / (2 * math.pi)
    expected = Tilted().eval(condition, wo) * (det / normal)
    torch.testing.assert_close(wo, expected_wo[:, 0], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(weight, expected, rtol=2e-3, atol=1e-4)
    assert inside_disk(wo).all() and (pdf > 0).all()
    torch.testing.assert_close(method.pdf(condition, wo), pdf)
    torch.testing.assert_close(method.sample(condition, u).wo, wo)
    assert not method.pdf(condition, torch.full((500, 2), 0.8)).any()


def test_the_map_learns_and_says_what_it_does(fitted):
    method, report = fitted
    assert report.loss[-1] < report.loss[0] - 1 and report.steps == 2 * BUDGET.steps
    assert "of p*" in report.notes and "bias" in report.notes and "\n" not in report.notes
    assert (
        not method.exact_pdf and method.reference_pdf(torch.zeros(1, 4), torch.zeros(1, 2)) is None
    )


def test_the_guess_is_near_the_density(fitted):
    """Of the map's own samples, where there is one preimage: N / det."""
    method, _ = fitted
    condition, u = Tilted().conditions(2000, rng(3)), torch.rand(2000, 3, generator=rng(4))
    z = normal_of_uniforms(u[:, None, :2])
    with torch.no_grad():
        wo, det = method.map(condition, z)
    density = torch.exp(-0.5 * z.square().sum(-1)) / (2 * math.pi) / det
    off = (method.pdf(condition, wo[:, 0]) / density[:, 0]).log()
    assert off.abs().median() < 0.6


def test_a_check_fails_what_it_declares_and_nothing_else():
    wanted = (
        "weights",
        "sample-pdf",
        "pdf-finite",
        "u-corners",
        "rows",
        "nan-confined",
        "save-load",
    )
    found = run_checks(registry.make(NAME), Plain(), only=wanted)
    failed = {finding.property for finding in found if not finding.ok}
    assert failed <= set(registry.load(NAME).fails) == {"weights"}
    assert {"rows", "save-load", "sample-pdf"} <= {f.property for f in found if f.ok}


def test_material_without_a_gradient():
    walks = materials.make("ggx-conductor")
    able, reason = registry.make(NAME).supports(walks)
    assert not able and "random walks" in reason
    with pytest.raises(Unsupported, match="no gradient of f"):
        registry.make(NAME).fit(walks, BUDGET, rng(5))


def test_black_conditions_are_left_out_and_counted():
    few = Budget(steps=2, conditions=8, directions=9, pool=64)
    report = registry.make(NAME).fit(HalfBlack(), few, rng(6))
    assert "black conditions left out" in report.notes


def test_certified_refuses_the_rim():
    """A short fit does not reach it; a state that was given says so in one line."""
    strict = registry.make(NAME, certified=True)
    with pytest.raises(StateRefused, match="not reached.*expected") as caught:
        strict.fit(Plain(), Budget(steps=5, conditions=16, directions=16, pool=32), rng(7))
    assert "\n" not in str(caught.value) and caught.value.number > 1e-3


@pytest.mark.parametrize("params", [{"width": 0}, {"layers": 0}, {"frequencies": -1}])
def test_refused_parameters(params):
    with pytest.raises(InputError, match="at least one of width and layers"):
        registry.make(NAME, **params)
