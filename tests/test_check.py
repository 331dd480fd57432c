"""``harness check`` catches every planted fault with the property meant for it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
import typer
from torch import Tensor
from typer.testing import CliRunner

from harness.check import Finding, run_checks
from harness.check.distribution import check_distribution
from harness.check.quadrature import (
    Hints,
    hemisphere_to_square,
    integrate,
    per_square,
    square_to_hemisphere,
)
from harness.check.subject import Subject, cases
from harness.protocol import Material, Method, Unsupported, cos_theta, inside_disk, square_to_disk
from harness.stats.cells import Cells
from tests import planted


def failed(findings: list[Finding]) -> set[str]:
    """Names of the properties that do not hold."""
    return {finding.property for finding in findings if not finding.ok}


def test_a_correct_adapter_passes_and_again_alike() -> None:
    first, second = (run_checks(planted.Correct(), planted.Plaster(), 5) for _ in range(2))
    assert not [finding.line() for finding in first if not finding.ok]
    assert {"integral", "samples-pdf", *planted.CAUGHT_BY.values()} - {"fit"} == {
        finding.property for finding in first
    }
    assert [f.line() for f in first] == [f.line() for f in second]


class Caught(Exception):
    """Ends a check that has found what it should."""


@pytest.mark.parametrize("wrong", planted.CAUGHT_BY, ids=lambda wrong: wrong.name)
def test_a_planted_fault_is_caught(wrong: type[Method]) -> None:
    def stop(finding: Finding) -> None:
        if not finding.ok and finding.property == planted.CAUGHT_BY[wrong]:
            raise Caught(finding.line())

    with pytest.raises(Caught, match="^FAIL"):
        run_checks(wrong(), planted.Plaster(), 3, notify=stop)


def test_faults_of_the_distribution_spoil_nothing_else() -> None:
    findings = run_checks(planted.ForgetsJacobian(), planted.Plaster())
    assert failed(findings) == {"samples-pdf"}
    worst = next(f for f in findings if not f.ok).worst
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


@pytest.mark.parametrize("method", [Rim, Narrow, Steps])
def test_hard_but_correct_distributions_pass(method: type[Method]) -> None:
    generator = torch.Generator().manual_seed(11)
    adapter, material = method(), planted.Plaster()
    adapter.fit(material, None, generator)
    subject = Subject(adapter, adapter, material, "cpu", generator)
    for case in cases(material, generator, "cpu")[:4]:
        findings = list(check_distribution(subject, case, 4e-5))
        assert [f.property for f in findings] == ["sample's-pdf", "integral", "samples-pdf"]
        assert not [f.line() for f in findings if not f.ok]


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


def application() -> typer.Typer:
    """The command alone; a second one makes typer keep its name."""
    from harness.cli.check import register

    app = typer.Typer()
    register(app)
    app.command("other")(lambda: None)
    return app


def test_command_line(tmp_path) -> None:
    pytest.importorskip("mitsuba")
    file = tmp_path / "mine.py"
    file.write_text(
        "import torch\n"
        "from harness.protocol import DiskSample, Method, inside_disk, square_to_disk\n"
        "class Mine(Method):\n"
        "    name = 'mine'\n"
        "    scale = 1.0\n"
        "    def sample(self, condition, u):\n"
        "        wo = square_to_disk(u[:, :2])\n"
        "        return DiskSample(wo, self.pdf(condition, wo))\n"
        "    def pdf(self, condition, wo):\n"
        "        return torch.where(inside_disk(wo), self.scale / torch.pi, 0)\n"
        "class Wrong(Mine):\n"
        "    name = 'wrong'\n"
        "    scale = 1.03\n"
    )
    run = CliRunner().invoke
    good = run(application(), ["check", f"{file}:Mine", "--material", "suede", "--mitsuba"])
    assert good.exit_code == 0, good.output
    assert "FAIL" not in good.output and "mitsuba-chi2" in good.output
    wrong = run(application(), ["check", f"{file}:Wrong", "--material", "suede"])
    assert wrong.exit_code == 1
    assert "FAIL  integral" in wrong.output and "--seed=0" in wrong.output
