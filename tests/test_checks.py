"""``harness check`` catches every planted fault with the property meant for it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from harness.checks import properties
from harness.checks.catalogue import BASE, CATALOGUE, HardCase
from harness.checks.finding import Finding, verdict
from harness.checks.quadrature import (
    Hints,
    hemisphere_to_square,
    integrate,
    per_square,
    square_to_hemisphere,
)
from harness.checks.run import FALSE_ALARM, ORDINARY, fit, run_case, run_checks
from harness.checks.subject import COSINES, stream
from harness.core import registry
from harness.core.protocol.disk import cos_theta, inside_disk, square_to_disk
from harness.core.protocol.errors import StateRefused, Unsupported
from harness.core.protocol.material import Material
from harness.core.protocol.method import Method
from harness.materials import registry as materials
from harness.stats.cells import Cells
from harness.stats.chisquare import sidak
from tests import planted

SEEDS = 10
EACH = sidak(FALSE_ALARM, ORDINARY * properties.tests())
"""Level of one test among all those of a run."""


def failed(findings: list[Finding]) -> set[str]:
    """Names of the properties that do not hold."""
    return {finding.property for finding in findings if not finding.ok}


def at_level(name: str) -> float:
    """Level of a run of one property such that each test has the level of a whole run."""
    return -math.expm1(ORDINARY * properties.tests((name,)) * math.log1p(-EACH))


# --- the properties, on adapters that are right, and wrong ---------------------------------------


@pytest.mark.parametrize(
    "right",
    [
        pytest.param(planted.Correct, id="correct"),
        pytest.param(planted.Bare, id="bare", marks=pytest.mark.slow),
    ],
)
def test_a_correct_adapter_passes(right: type[Method]) -> None:
    findings = run_checks(right(), planted.Plaster(), 5)
    assert not [finding.line() for finding in findings if not finding.ok]
    assert {f.property for f in findings} == set(properties.names())
    assert set(planted.CAUGHT_BY.values()) <= set(properties.names())


@functools.cache
def of_forgets_jacobian() -> list[Finding]:
    """Everything about an adapter that is wrong in its distribution alone."""
    return run_checks(planted.ForgetsJacobian(), planted.Plaster(), 5)


@pytest.mark.slow
def test_one_property_alone_draws_what_it_draws_among_all() -> None:
    every = of_forgets_jacobian()
    for name in ("samples-pdf", "coverage"):
        alone = run_checks(
            planted.ForgetsJacobian(), planted.Plaster(), 5, only=(name,), alpha=at_level(name)
        )
        assert [f.line() for f in alone] == [
            f.line() for f in every if f.property in (name, *properties.PER_CASE[name].also)
        ]


class Caught(Exception):
    """Ends a check that has found what it should."""


def catch(wrong: type[Method], seed: int) -> None:
    """Check until the property meant for the fault fails, at the level of a whole run."""
    name = planted.CAUGHT_BY[wrong]

    def stop(finding: Finding) -> None:
        if not finding.ok and finding.property == name:
            raise Caught(finding.line())

    material = planted.NEEDS.get(wrong, planted.Plaster)()
    with pytest.raises(Caught, match="^FAIL"):
        run_checks(wrong(), material, seed, notify=stop, only=(name,), alpha=at_level(name))


@pytest.mark.parametrize("wrong", planted.CAUGHT_BY, ids=lambda wrong: wrong.name)
def test_a_planted_fault_is_caught(wrong: type[Method]) -> None:
    catch(wrong, 3)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", planted.CAUGHT_BY, ids=lambda wrong: wrong.name)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_planted_fault_is_caught_with_every_seed(wrong: type[Method], seed: int) -> None:
    catch(wrong, seed)


@pytest.mark.slow
@pytest.mark.parametrize("right", [planted.Correct, planted.Bare], ids=lambda right: right.name)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_correct_adapter_passes_with_every_seed(right: type[Method], seed: int) -> None:
    findings = run_checks(right(), planted.Plaster(), seed)
    assert not [finding.line() for finding in findings if not finding.ok]


@pytest.mark.slow
def test_p_values_of_a_correct_adapter_are_uniform() -> None:
    values = [
        finding.number
        for seed in range(40)
        for finding in run_checks(planted.Correct(), planted.Plaster(), seed, only=("samples-pdf",))
        if finding.unit == "p-value"
    ]
    assert len(values) == 40 * ORDINARY
    # A seed's tests are of different conditions and samples: independent.
    assert stats.kstest(values, "uniform").pvalue > 1e-3


@pytest.mark.slow
def test_faults_of_the_distribution_spoil_no_call() -> None:
    findings = of_forgets_jacobian()
    assert {"samples-pdf"} <= failed(findings) <= {"samples-pdf", "tail", "weights"}
    worst = next(f for f in findings if f.property == "samples-pdf" and not f.ok).worst
    assert {"condition", "wo", "got", "expected"} <= set(worst)


def test_unsupported_is_no_failure() -> None:
    class Picky(planted.Correct):
        def supports(self, material: Material) -> tuple[bool, str]:
            return False, "only metals"

    with pytest.raises(Unsupported, match="only metals"):
        run_checks(Picky(), planted.Plaster())


class Rim(planted.Correct):
    """Uniform per solid angle: its density per disk area grows like 1/cos at the rim."""

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = ()) -> Tensor:
        turn = 2 * math.pi * u[:, 2]
        radius = (1 - u[:, 0].square()).sqrt()
        return radius[:, None] * torch.stack([turn.cos(), turn.sin()], -1)

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        return torch.where(inside_disk(wo), 1 / (2 * math.pi * cos_theta(wo)), 0)


class Narrow(planted.Correct):
    """A lobe of 0.06 degrees."""

    sigmas = (1e-3, 1e-2)


class Steps(planted.Correct):
    """A histogram whose cells do not line up with those of the test, and differ a lot."""

    n = 24

    def table(self) -> Tensor:
        weight = torch.rand(self.n**2, generator=torch.Generator().manual_seed(1)) ** 6
        return (weight / weight.sum()).double()

    def draw(self, condition: Tensor, u: Tensor, share: tuple[float, ...] = ()) -> Tensor:
        cell = torch.searchsorted(self.table().cumsum(0), u[:, 0].double())
        cell = cell.clamp(max=self.n**2 - 1)
        corner = torch.stack([cell // self.n, cell % self.n], -1)
        # Squares of the plane; those off the disk are invalid samples.
        return ((corner + u[:, 1:]) / self.n * 2 - 1).float()

    def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
        cell = ((wo + 1) / 2 * self.n).long()
        on = ((cell >= 0) & (cell < self.n) & (wo >= -1)).all(-1)
        cell = cell.clamp(0, self.n - 1)
        density = self.table()[cell[:, 0] * self.n + cell[:, 1]] * self.n**2 / 4
        return torch.where(on, density, 0).float()


SLOW_HARD = [pytest.param(method, marks=pytest.mark.slow) for method in (Rim, Steps)]


@pytest.mark.parametrize("method", [Narrow, *SLOW_HARD])
def test_hard_but_correct_distributions_pass(method: type[Method]) -> None:
    names = ("sample-pdf", "integral", "samples-pdf", "tail", "weights")
    findings = run_checks(method(), planted.Plaster(), 11, only=names)
    assert not [f.line() for f in findings if not f.ok]
    assert {f.property for f in findings} >= set(names)


def test_density_zero_by_underflow_is_not_a_hole() -> None:
    class Thin(planted.Bare):
        """Positive everywhere, yet below single precision far from its lobe."""

        sigmas = (0.05, 0.02)

        def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
            density = torch.zeros(len(wo), dtype=torch.float64)
            off = wo.double()[:, None] - self.centres(condition.double())
            for k, sigma in enumerate(self.sigmas):
                norm = self.weights[k + 1] / (2 * math.pi * sigma**2)
                density += norm * torch.exp(-0.5 * (off[:, k] / sigma).square().sum(-1))
            return density

    class Hole(Thin):
        """Zero where it is zero, whatever the precision."""

        def reference_pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
            return self.pdf(condition, wo).double()

    for method, expected in ((Thin, "degraded"), (Hole, "fail")):
        findings = run_checks(method(), planted.Plaster(), only=("coverage",))
        assert {f.verdict for f in findings} == {expected}
        assert all(0.1 < f.number < 1 for f in findings)


# --- verdicts and hard cases ---------------------------------------------------------------------


def test_the_verdict_is_the_worst() -> None:
    found = [Finding(v, "c", v, "") for v in ("skip", "pass", "degraded", "fail", "fail")]
    assert [verdict(found[:n]).verdict for n in range(1, 5)] == ["skip", "pass", "degraded", "fail"]
    assert verdict(found) is found[3]
    assert [f.ok for f in found] == [True, True, True, False, False]
    with pytest.raises(ValueError, match="expected one of"):
        Finding("integral", "c", "good", "")


def two_rows(material: Material, generator: torch.Generator, device: str) -> Tensor:
    """Normal incidence, and a random one."""
    rows = material.conditions(2, generator, device).clone()
    rows[0, -2:] = 0
    return rows


BOTH = HardCase("both", "direction", "", "plaster", two_rows)


def in_case(method: Method, case: HardCase, material: Material | None = None) -> list[Finding]:
    """The method, fitted to plaster, in one hard case."""
    material = material or planted.Plaster()
    subject, _ = fit(method, material, 2)
    assert subject is not None
    return run_case(method, subject.blank, material, case, 2)


def test_a_case_has_one_finding_for_each_property_the_worst_of_its_rows() -> None:
    class WrongAtNormal(planted.Correct):
        def pdf(self, condition: Tensor, wo: Tensor) -> Tensor:
            normal = (condition[:, -2:] == 0).all(-1)
            return torch.where(normal, 1.1, 1.0) * super().pdf(condition, wo)

    good, bad = in_case(planted.Correct(), BOTH), in_case(WrongAtNormal(), BOTH)
    also = properties.PER_CASE["weights"].also
    assert [f.property for f in good] == [
        *(name for name in properties.PER_CASE if name in BOTH.checks and name != "weights"),
        "invalid",
        "weights",
        *(name for name in also if name != "invalid"),
    ]
    assert {f.case for f in good} == {"both"} and not failed(good)
    assert verdict(bad).property == "integral"
    worst = next(f.worst for f in bad if f.property == "integral")
    assert worst["condition"] == "(0, 0)"


def test_states_are_loaded_into_a_fresh_copy() -> None:
    def stretched(method: Method, generator: torch.Generator) -> dict[str, Tensor]:
        return {"stretch": torch.tensor([torch.nan])}

    method = planted.Correct()
    broken = replace(BOTH, name="broken", group="state", alter=stretched)
    findings = in_case(method, broken)
    assert not next(f for f in findings if f.property == "pdf-finite").ok
    assert float(method.stretch) == pytest.approx(0.9)
    (none,) = in_case(method, replace(broken, alter=lambda method, generator: None))
    assert none.verdict == "skip"

    def misfit(method: Method, generator: torch.Generator) -> dict[str, Tensor]:
        return {}

    (misfits,) = in_case(method, replace(broken, alter=misfit))
    assert misfits.verdict == "fail" and "KeyError" in misfits.text


class Choosy(planted.Correct):
    """Refuses to be stretched by more than a factor of two; ``least`` may be made to refuse all."""

    least = 0.5

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Or says why not."""
        if (stretch := float(state["stretch"])) < self.least:
            raise StateRefused(f"choosy: state refused: a stretch of {stretch:.2g}", 1 - stretch)
        super().load_state_dict(state)


class RefusesItself(Choosy):
    """Its own fit as well."""

    least = 2.0


def test_a_refused_state_is_degraded_and_a_refused_fit_fails() -> None:
    def narrowed(method: Method, generator: torch.Generator) -> dict[str, Tensor]:
        return {"stretch": torch.tensor([0.25])}

    narrow = replace(BOTH, name="narrow", group="state", alter=narrowed)
    (refused,) = in_case(Choosy(), narrow)
    assert refused.verdict == "degraded" and refused.number == 0.75
    assert "state refused" in refused.text
    assert verdict(run_checks(Choosy(), planted.Plaster(), only=("save-load",))).verdict == "pass"
    assert failed(run_checks(RefusesItself(), planted.Plaster(), only=("save-load",)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("name", ["neural-spline-flow", "realnvp"])
def test_diverged_flows_are_right_or_refused(name: str, seed: int) -> None:
    subject, _ = fit(registry.make(name), materials.make(BASE), seed)
    assert subject is not None
    case = CATALOGUE["badly-trained"]
    assert not failed(run_case(subject.method, subject.blank, subject.material, case, seed))


def test_an_input_case_is_its_property() -> None:
    case = replace(BOTH, name="ends", group="input", inputs="u-corners")
    (finding,) = in_case(planted.NanAtZero(), case)
    assert (finding.property, finding.case, finding.verdict) == ("u-corners", "ends", "fail")
    case = replace(case, inputs="float64")
    (finding,) = in_case(planted.Correct(), case)
    assert finding.ok and finding.text.startswith(tuple(COSINES))


def test_the_catalogue_asks_for_properties_that_there_are() -> None:
    for case in CATALOGUE.values():
        assert set(case.checks) <= set(properties.PER_CASE)
        if case.inputs:
            assert case.inputs in {**properties.PER_CASE, **properties.PER_METHOD}


def test_streams_differ_by_every_word() -> None:
    words = [(0, "a", "b"), (1, "a", "b"), (0, "ab"), (0, "b", "a")]
    drawn = {float(torch.rand(1, generator=stream(*w))) for w in words}
    assert len(drawn) == 4
    again = torch.rand(1, generator=stream(*words[0]))
    assert torch.equal(again, torch.rand(1, generator=stream(*words[0])))


def test_hemisphere_map_is_its_own_inverse() -> None:
    square = np.random.default_rng(0).random((5000, 2))
    wo, cos = square_to_hemisphere(square)
    back, valid = hemisphere_to_square(wo)
    # Single-precision wo knows a cosine c only to about 1e-7 / c.
    clear = cos[valid] > 0.01
    assert valid.mean() > 0.999
    assert np.abs(back - square[valid])[clear].max() < 1e-4
    assert cos_theta(wo)[torch.from_numpy(cos > 0.01)].numpy() == pytest.approx(
        cos[cos > 0.01], abs=1e-5
    )
    assert cos.mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("density", "truth"),
    [
        (lambda wo: torch.full((len(wo),), 1 / math.pi), 1.0),
        (lambda wo: torch.where(inside_disk(wo), 1 / (2 * math.pi * cos_theta(wo)), 0), 1.0),
        (lambda wo: torch.where((wo - 0.5).square().sum(-1) < 1e-4, 1e4 / math.pi, 0), 1.0),
        (lambda wo: torch.where(wo[:, 0] > 0.1234, 1 / math.pi, 0), 0.42166),
    ],
    ids=["uniform", "rim", "spot", "half"],
)
def test_quadrature(density: Callable[[Tensor], Tensor], truth: float) -> None:
    # Hints: uniform on the disk, and some on the spot of radius 0.01 at (0.5, 0.5).
    random = torch.rand(50_000, 2, generator=torch.Generator().manual_seed(0))
    near = 0.5 + 0.01 * square_to_disk(random)
    wo = torch.cat([square_to_disk(random), near])
    hints = Hints(hemisphere_to_square(wo)[0], per_square(density(wo), wo))
    rng = np.random.default_rng(0)
    masses = integrate(density, hints, rng, Cells.uniform(4).refined(hints.points, 32))
    assert masses.error < 1e-3
    assert masses.total == pytest.approx(truth, abs=5 * masses.error + 1e-4)


@pytest.mark.parametrize("n", [0, 1, 500])
def test_hints_in_cells(n: int) -> None:
    """Count and maximum for each cell, against a search point by point."""
    rng = np.random.default_rng(3)
    points, density = rng.random((n, 2)) ** 3, rng.random(n)
    cells = Cells.uniform(2).refined(points, 20)
    hints, owner = Hints(points, density), cells.find(points)
    assert (hints.count(cells) == cells.count(points)).all()
    expected = [density[owner == k].max(initial=0.0) for k in range(len(cells))]
    assert (hints.highest(cells) == expected).all()
