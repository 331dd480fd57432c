"""The search for the best form: the same for all methods, written to a file that suites read."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from harness._methods.neural_spline_flow import NeuralSplineFlow
from harness.cli.main import main
from harness.core.protocol.errors import InputError
from harness.core.protocol.method import Budget
from harness.runner import tuning
from harness.runner.tuning import Tried, forms, space
from harness.suite.load import load
from harness.suite.plan import make_plan
from harness.suite.tuned import with_tuned


def test_space_is_knobs_and_forms():
    """What changes only the bytes of the weights, or the budget, is no form."""
    found = space(NeuralSplineFlow)
    assert set(found) == {"bins", "couplings", "width", "layers", "domain", "lambertian", "uniform"}
    assert found["domain"] == ("disk", "square")


def test_forms():
    """The suite's own first, then different ones; equal seeds, equal forms; its own words stay."""
    own = {"width": 16}
    found = list(forms("neural-spline-flow", own, 6, 0))
    assert found == list(forms("neural-spline-flow", own, 6, 0))
    assert found != list(forms("neural-spline-flow", own, 6, 1))
    assert found[0] == own and len(found) == 6
    assert all(found.count(one) == 1 and one["width"] == 16 for one in found)
    assert list(forms("cosine", {}, 6, 0)) == [{}]
    few = list(forms("improved-baseline", {"width": 8}, 9, 0))
    assert len(few) == 4  # three numbers of layers, and the default


def test_the_best_has_the_lowest_geometric_mean():
    """A form that failed on one material is none."""
    a, b = Tried({}, {"x": 0.1, "y": 0.4}), Tried({}, {"x": 0.2, "y": 0.1})
    c = Tried({}, {"x": 0.01}, failed="y: no luck")
    assert sorted([a, b, c], key=lambda one: one.score) == [b, a, c]
    assert math.isinf(c.score) and c.as_data() == {"params": {}, "failed": "y: no luck"}


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """A suite of two methods that are fitted and one that is not, on one material."""
    path = tmp_path / "suite.yaml"
    data = {
        "name": "suite",
        "title": "to tune",
        "tuned": "found.yaml",
        "materials": [{"name": "paint", "type": "mitsuba", "bsdf": {"type": "roughplastic"}}],
        "methods": ["cosine", "two-lobe", {"name": "improved-baseline", "params": {"width": 16}}],
        "measures": ["pdf"],
        "budget": {"conditions": 16, "directions": 8, "pool": 16},
    }
    path.write_text(yaml.safe_dump(data), "utf-8")
    return path


def test_command(suite: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch):
    """Writes what a run of the suite reads: all that was tried, by steps and KL, the best first."""
    # On a busy machine the data alone would take that long.
    monkeypatch.setattr(Budget, "less", lambda budget, seconds, parts=1: budget)
    with pytest.raises(InputError, match="no such file: .*found.yaml; 'harness tune' writes it"):
        load(suite)
    assert main(["tune", str(suite), "--trials", "2", "--seconds", "0.3"]) == 0
    data = yaml.safe_load((suite.parent / "found.yaml").read_text("utf-8"))
    assert list(data["methods"]) == ["two-lobe", "improved-baseline (width=16)"]
    assert data["seconds"] == 0.3 and data["materials"] == ["paint"]
    for entry in data["methods"].values():
        assert len(entry["tried"]) == 2 and entry["params"] == entry["tried"][0]["params"]
        good = [one for one in entry["tried"] if "kl" in one]
        assert good and all(one["steps"]["paint"] > 0 and one["kl"]["paint"] > 0 for one in good)
        assert [one["kl"]["paint"] for one in good] == sorted(one["kl"]["paint"] for one in good)
    plan = make_plan(load(suite))
    found = {t.method: t.params for t in plan.trials}
    assert found["two-lobe"] == data["methods"]["two-lobe"]["params"]
    assert found["improved-baseline (width=16)"]["width"] == 16
    assert "the best of 2 forms of 2 methods" in capsys.readouterr().out


def test_command_refuses(suite: Path, capsys: pytest.CaptureFixture):
    """A material that is not there, and a suite that names no file."""
    assert main(["tune", str(suite), "--material", "pain"]) == 2
    assert "--material pain: not in" in capsys.readouterr().err
    suite.write_text(suite.read_text("utf-8").replace("tuned: found.yaml\n", ""), "utf-8")
    assert main(["tune", str(suite)]) == 2
    assert "expected --out FILE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("methods: 3", "expected what harness tune writes"),
        ("methods: {two-lob: {params: {}}}", "has none of the suite's methods"),
        ("methods: {two-lobe: 3}", "expected 'params' under every method"),
    ],
)
def test_files_of_another_kind(suite: Path, text: str, said: str):
    """Are refused, with what was expected."""
    (suite.parent / "found.yaml").write_text(text, "utf-8")
    with pytest.raises(InputError, match=said):
        load(suite)
    with pytest.raises(InputError, match=said):
        with_tuned(load(suite, tuned=False).suite.methods, suite.parent / "found.yaml")


def test_a_budget_that_its_data_use_up(suite: Path):
    """Is a failure of the form, with the reason."""
    plan = make_plan(load(suite, tuned=False))
    fits = [t for t in plan.trials if t.measure == "fit" and t.method == "two-lobe"]
    said: list[str] = []
    found = tuning.tune(fits, plan.resolved.material, 2, 1e-9, said.append)
    assert [one.failed[:15] for one in found["two-lobe"]] == ["paint: its data"] * 2
    assert found["two-lobe"][0].params == {}
    assert said[-1] == "two-lobe: no form could be fitted; the suite's own stays"
