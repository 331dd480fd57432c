"""Sweeps over knobs in a suite."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest
import yaml

from harness.core import registry
from harness.core.protocol.errors import InputError
from harness.suite.load import load
from harness.suite.plan import Plan, make_plan
from harness.suite.schema import BudgetSpec
from tests import fakes

# --- sweeps ------------------------------------------------------------------------------------


@pytest.fixture
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    fakes.install(monkeypatch.setattr)


def plan_of(folder: Path, methods: list, **changes: Any) -> Plan:
    return make_plan(load(fakes.suite(folder, methods=methods, baseline=None, **changes)))


def hashes(plan: Plan) -> dict[str, set[str]]:
    return {m: {t.hash for t in plan.trials if t.method == m} for m in plan.labels("method")}


FLOW = "neural-spline-flow"


@pytest.mark.usefixtures("_fakes")
def test_a_sweep_is_the_methods_written_out(tmp_path: Path):
    swept = plan_of(tmp_path / "a", ["cosine", {"name": FLOW, "sweep": {"bins": [5, 20, 40]}}])
    assert swept.labels("method") == ["cosine", FLOW, f"{FLOW} bins=5", f"{FLOW} bins=40"]
    by_hand = plan_of(
        tmp_path / "b",
        [
            "cosine",
            FLOW,
            {"name": FLOW, "label": f"{FLOW} bins=5", "params": {"bins": 5}},
            {"name": FLOW, "label": f"{FLOW} bins=40", "params": {"bins": 40}},
        ],
    )
    assert hashes(swept) == hashes(by_hand)


@pytest.mark.usefixtures("_fakes")
def test_knobs_move_one_at_a_time(tmp_path: Path):
    base = {"name": "two-lobe", "label": "lobes", "params": {"width": 16}, "budget": {"steps": 7}}
    sweep = {"width": [16, 32], "lobes": [1, 2], "budget.steps": [7, 9]}
    plan = plan_of(tmp_path, [{**base, "sweep": sweep}])
    found = {t.method: (t.params, t.budget.steps) for t in plan.trials}
    assert found == {
        "lobes": ({"width": 16}, 7),
        "lobes width=32": ({"width": 32}, 7),
        "lobes lobes=1": ({"width": 16, "lobes": 1}, 7),
        "lobes budget.steps=9": ({"width": 16}, 9),
    }


@pytest.mark.usefixtures("_fakes")
def test_all_declared_knobs(tmp_path: Path):
    plan = plan_of(tmp_path, [{"name": FLOW, "sweep": "knobs"}])
    loaded = registry.load(FLOW)
    defaults = {k: p.default for k, p in inspect.signature(loaded).parameters.items()}
    expected = [FLOW] + [
        f"{FLOW} {knob.name}={value}"
        for knob in loaded.knobs
        for value in knob.values
        if value != defaults.get(knob.name)
    ]
    assert plan.labels("method") == expected


@pytest.mark.usefixtures("_fakes")
def test_a_profile_reaches_the_variants(tmp_path: Path):
    """All but the knob that a variant stands for, unless its own label is named."""
    override = {
        "two-lobe": {"params": {"width": 8, "lobes": 3}, "budget": {"steps": 50, "pool": 5}},
        "two-lobe width=64": {"params": {"width": 48}},
    }
    methods = [
        {"name": "two-lobe", "sweep": {"width": [16, 64], "lobes": [4], "budget.steps": [9]}}
    ]
    plan = plan_of(tmp_path, methods, profiles={"quick": {"override": override}})
    found = {t.method: (t.params, t.budget.steps, t.budget.pool) for t in plan.trials}
    assert found == {
        "two-lobe": ({"width": 8, "lobes": 3}, 50, 5),
        "two-lobe width=16": ({"width": 16, "lobes": 3}, 50, 5),
        "two-lobe width=64": ({"width": 48, "lobes": 3}, 50, 5),
        "two-lobe lobes=4": ({"width": 8, "lobes": 4}, 50, 5),
        "two-lobe budget.steps=9": ({"width": 8, "lobes": 3}, 9, 5),
    }


@pytest.mark.usefixtures("_fakes")
@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ({"binz": [5]}, "unknown knob 'binz' of neural-spline-flow; did you mean 'bins'?"),
        ({"budget.step": [5]}, "unknown knob 'budget.step'; did you mean 'budget.steps'?"),
        ({"budget.steps": ["few"]}, "budget.steps: expected a valid integer, got 'few'"),
        ({"bins": 5}, "bins: expected a list of values, got 5"),
        ({"bins": []}, "bins: expected a list of values, got []"),
        ({"bins": [5, 5]}, "bins: 5 is listed twice"),
        ("bins", "expected 'knobs', or lists of values by knob"),
        ({}, "expected 'knobs', or lists of values by knob"),
        ([5], "expected 'knobs', or lists of values by knob"),
    ],
)
def test_bad_sweeps_are_refused(tmp_path: Path, sweep: Any, message: str):
    with pytest.raises(InputError) as error:
        plan_of(tmp_path, ["cosine", {"name": FLOW, "sweep": sweep}])
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith(f"{tmp_path / 'suite.yaml'}: methods[1].sweep: {message}")


@pytest.mark.usefixtures("_fakes")
def test_nothing_to_sweep(tmp_path: Path):
    with pytest.raises(InputError, match=r"methods\[0\].sweep: cosine declares no knobs"):
        plan_of(tmp_path, [{"name": "cosine", "sweep": "knobs"}])


def test_budget_knobs_are_the_budgets():
    for name in registry.names():
        for knob in registry.load(name).knobs:
            if knob.name.startswith("budget."):
                assert knob.name.removeprefix("budget.") in BudgetSpec.model_fields


def test_validate_shows_the_expansion(tmp_path: Path, capsys: pytest.CaptureFixture):
    from harness.cli.main import main

    suite = {
        "name": "swept",
        "materials": ["suede"],
        "methods": [{"name": "two-lobe", "sweep": {"lobes": [1, 2, 4]}}],
        "measures": ["pdf"],
    }
    (tmp_path / "swept.yaml").write_text(yaml.safe_dump(suite))
    assert main(["validate", str(tmp_path / "swept.yaml")]) == 0
    said = capsys.readouterr().out
    assert "two-lobe sweeps lobes=1, lobes=4" in said and "3 methods" in said


@pytest.mark.parametrize("name", ["pareto", "convergence"])
def test_shipped_sweeps_expand(name: str):
    """Knobs of the shipped suites exist, and no two methods of a suite are the same."""
    plan = make_plan(load(name), "quick")
    fits = [t for t in plan.trials if t.measure == "fit" and t.material == plan.trials[0].material]
    assert len({t.hash for t in fits}) == len(fits) == len(plan.labels("method"))
