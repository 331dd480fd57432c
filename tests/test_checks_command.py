"""What a check covers, and ``harness check``."""

from __future__ import annotations

import shlex

import pytest
import typer
from typer.testing import CliRunner

from harness.checks import plan
from harness.checks.catalogue import BASE, CATALOGUE
from harness.checks.run import FALSE_ALARM, ORDINARY
from harness.core.protocol.errors import InputError
from harness.stats.chisquare import sidak

# --- the plan and the command --------------------------------------------------------------------


def test_by_default_the_base_and_a_few_more() -> None:
    made = plan.make_plan()
    assert [p.material for p in made.parts if p.ordinary] == list(plan.DEFAULT_MATERIALS)
    cases = [case for part in made.parts for case in part.cases]
    assert set(plan.DEFAULT_CASES) <= {case.name for case in cases}
    on_base = {c.name for c in CATALOGUE.values() if c.material == BASE and not c.inputs}
    assert on_base <= {case.name for case in cases}
    # Each input case is a property that the ordinary cases have run already.
    assert not any(case.inputs for case in cases)
    every = plan.make_plan(everything=True)
    assert {c.name for p in every.parts for c in p.cases} == {
        c.name for c in CATALOGUE.values() if not c.inputs
    }
    assert every.level < made.level < FALSE_ALARM


def test_a_plan_takes_what_is_named_and_no_more() -> None:
    (part,) = plan.make_plan(["suede"]).parts
    assert part.ordinary and not part.cases
    (part,) = plan.make_plan((), ["half-million-rows", "grazing-1e-4"]).parts
    assert not part.ordinary and len(part.cases) == 2
    one = plan.make_plan(["suede"], (), ["integral"])
    assert one.level == pytest.approx(sidak(FALSE_ALARM, ORDINARY))
    assert plan.make_plan(["suede"], (), [plan.MITSUBA]).mitsuba


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ((["sued"], [], []), "did you mean 'suede'"),
        (([], ["grazing-1e-9"], []), "did you mean 'grazing-1e-"),
        (([], [], ["integrall"]), "did you mean 'integral'"),
    ],
)
def test_unknown_names_are_refused(wishes, message) -> None:
    with pytest.raises(InputError, match=message):
        plan.make_plan(*wishes)


def application() -> typer.Typer:
    """The command alone; a second one makes typer keep its name."""
    from harness.cli.check import register

    app = typer.Typer()
    register(app)
    app.command("other")(lambda: None)
    return app


@pytest.fixture
def adapter(tmp_path) -> str:
    """A file with a method that is right, or not, by its parameter ``scale``."""
    pytest.importorskip("mitsuba")
    file = tmp_path / "mine.py"
    file.write_text(
        "import torch\n"
        "from harness import DiskSample, Method\n"
        "from harness.core.protocol.disk import inside_disk, square_to_disk\n"
        "class Mine(Method):\n"
        "    name = 'mine'\n"
        "    def __init__(self, scale=1.0):\n"
        "        self.scale = scale\n"
        "    def sample(self, condition, u):\n"
        "        wo = square_to_disk(u[:, :2])\n"
        "        return DiskSample(wo, self.pdf(condition, wo))\n"
        "    def pdf(self, condition, wo):\n"
        "        return torch.where(inside_disk(wo), self.scale / torch.pi, 0)\n"
    )
    return f"{file}:Mine"


def test_quiet_prints_failures_and_the_counts(adapter) -> None:
    run, asked = CliRunner().invoke, ["--quiet", "--material=suede", "--property=integral"]
    good = run(application(), ["check", adapter, *asked])
    assert good.exit_code == 0 and len(good.output.splitlines()) == 1
    wrong = run(application(), ["check", adapter, *asked, "--param", "scale=1.03"])
    lines = wrong.output.splitlines()
    assert wrong.exit_code == 1 and lines[0].startswith("FAIL") and "failed" in lines[-1]
    assert not any(line.startswith("pass ") for line in lines)


def test_command_line(adapter) -> None:
    run = CliRunner().invoke
    chosen = ["--property=integral", "--property=coverage"]
    some = ["check", adapter, "--material=suede", "--case=normal", "--case=rim-lobe", *chosen]
    good = run(application(), [*some, "--property=mitsuba-chi2"])
    assert good.exit_code == 0, good.output
    assert "FAIL" not in good.output and "mitsuba-chi2" in good.output
    assert good.output.endswith("passed, 0 degraded, 0 failed, 0 skipped\n")
    wrong = run(application(), [*some, "--param", "scale=1.03", "--seed=4"])
    assert wrong.exit_code == 1
    lines = wrong.output.splitlines()
    found = next(k for k, line in enumerate(lines) if line.startswith("FAIL") and "rim-" in line)
    assert "worst: condition" in lines[found + 1] and "expected 1.00000" in lines[found + 1]
    # The command that is printed gives the same failure again.
    again = shlex.split(lines[found + 2].partition("again: harness ")[2])
    assert "--case=rim-lobe" in again and "--param=scale=1.03" in again
    same = run(application(), again)
    assert same.exit_code == 1
    assert lines[found].split("(may")[0] in same.output
    assert same.output.count("FAIL") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--param", "scale"], "expected KEY=VALUE"),
        (["--param", "scael=1"], "did you mean 'scale'"),
        (["--case", "grasing-1e-2"], "did you mean 'grazing-1e-2'"),
        (["--material", "suede", "--property", "integrl"], "did you mean 'integral'"),
        (["--case", "normal", "--property", "u-corners"], "nothing to check"),
    ],
)
def test_the_command_refuses_what_is_unknown(adapter, words, message) -> None:
    result = CliRunner().invoke(application(), ["check", adapter, *words])
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)


def test_parameters_are_read_as_in_a_suite() -> None:
    from harness.cli.check import parameters

    given = ["a=1", "b=1e-3", "c=true", "d=[1, 2]", "e=text", "f=2.5", "g=a=b"]
    assert parameters(given) == {
        "a": 1,
        "b": 1e-3,
        "c": True,
        "d": [1, 2],
        "e": "text",
        "f": 2.5,
        "g": "a=b",
    }


def test_what_does_not_apply_is_said_once(adapter) -> None:
    words = ["check", adapter, "--material=suede", "--property=invertible"]
    result = CliRunner().invoke(application(), words)
    assert result.exit_code == 0
    assert result.output.count("no inverse") == 1
    assert result.output.endswith("0 passed, 0 degraded, 0 failed, 1 skipped\n")
